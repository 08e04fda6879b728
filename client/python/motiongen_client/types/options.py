"""The options with which a session is opened."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Motion
from motiongen_client.types.checks import as_tuple, check_finite, check_flag, check_text, check_type, check_whole

NO_PROMPTS: Mapping[int, str] = MappingProxyType({})


class Priority(enum.Enum):
    """How much a session matters when the server must choose between sessions."""

    HERO = "hero"
    NEAR = "near"
    CROWD = "crowd"
    BATCH = "batch"


class FrameFormat(enum.Enum):
    """How frames are encoded on the wire. F16: half the bytes; QUANTISED: a quarter (`docs/protocol.md`)."""

    F32 = "f32"
    F16 = "f16"
    QUANTISED = "quantised"


@dataclass(frozen=True)
class StartPose:
    """Where a character stands at frame 0: world metres, heading in radians (0 faces +Z)."""

    x_m: float = 0.0
    z_m: float = 0.0
    heading_rad: float = 0.0

    def __post_init__(self) -> None:
        check_finite("x_m", self.x_m)
        check_finite("z_m", self.z_m)
        check_finite("heading_rad", self.heading_rad)


@dataclass(frozen=True)
class SessionOptions:
    """The options of a session; None and "" leave a choice to the server.

    seed: the same seed and the same events at the same frames give the same motion. lookahead_frames: how far ahead of
    the playhead the server may send. denoise_steps: fewer are faster, more give finer motion. text_guidance and
    constraint_guidance: how strongly prompt and constraints are followed; 0: not at all. history_frames: how many
    frames before it each window sees. prior: the frames just before frame 0, instead of `start`. keep_prompts: prompts
    hold even if constraints ask for another pace; otherwise the one of `Model.locomotion_presets` for that pace does.
    outputs: names from `Model.outputs`, which each frame then has too: `frame.output(name)`.
    """

    model_id: str = ""
    rig_id: str = ""
    seed: int | None = None
    priority: Priority = Priority.NEAR
    lookahead_frames: int | None = None
    denoise_steps: int | None = None
    text_guidance: float | None = None
    constraint_guidance: float | None = None
    start: StartPose = field(default_factory=StartPose)
    history_frames: int | None = None
    prior: Motion | None = None
    keep_prompts: bool = False
    frame_format: FrameFormat = FrameFormat.F32
    outputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("model_id", "rig_id"):
            if getattr(self, name) is not None:
                check_text(name, getattr(self, name), 'an id of the catalogue, or ""')
        check_type("priority", self.priority, Priority, "a Priority")
        check_type("frame_format", self.frame_format, FrameFormat, "a FrameFormat")
        check_type("start", self.start, StartPose, "a StartPose")
        check_type("prior", self.prior, Motion | None, "a Motion, or None")
        check_flag("keep_prompts", self.keep_prompts)
        allowed = "names of Model.outputs, such as ('joint_positions_m',)"
        object.__setattr__(self, "outputs", as_tuple("outputs", self.outputs, allowed))
        for output in self.outputs:
            check_text("outputs", output, allowed)
        if self.prior is not None and self.start != StartPose():
            raise InvalidInput("start", self.start, "none beside prior, whose last frame is where the character starts")
        if self.seed is not None:
            check_whole("seed", self.seed, "a whole number from 0 to 2**64 - 1", most=2**64 - 1)
        for name in ("lookahead_frames", "denoise_steps", "history_frames"):
            value = getattr(self, name)
            if value is not None:
                check_whole(name, value, "a whole number of 1 or more, or None for the server's default", least=1)
        for name in ("text_guidance", "constraint_guidance"):
            if getattr(self, name) is not None:
                check_finite(name, getattr(self, name))
