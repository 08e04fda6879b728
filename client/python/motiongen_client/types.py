"""What a client says to the server and hears from it, as frozen dataclasses of numbers, strings and numpy arrays."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from motiongen_client.errors import InvalidInput, UnknownName
from motiongen_client.motion import Motion, Rig

NO_PROMPTS: Mapping[int, str] = MappingProxyType({})


class Priority(enum.Enum):
    """How much a session matters when the server has to choose."""

    HERO = "hero"
    NEAR = "near"
    CROWD = "crowd"
    BATCH = "batch"


@dataclass(frozen=True)
class Waypoint:
    """The root on the ground at one frame. x_m, z_m: world metres; heading_rad: 0 faces +Z, None leaves it free.

    tolerance_m, tolerance_rad: how far it may be missed and still count as met, here and in the other constraints;
    None for the model's own (`Model.default_tolerance_m`, `default_tolerance_rad`).
    """

    frame: int
    x_m: float
    z_m: float
    heading_rad: float | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        check_finite("x_m", self.x_m)
        check_finite("z_m", self.z_m)
        if self.heading_rad is not None:
            check_finite("heading_rad", self.heading_rad)


@dataclass(frozen=True, eq=False)
class RootTrajectory:
    """The root on the ground at consecutive frames from `first_frame`.

    positions_m: (N, 2) world x, z in metres; headings_rad: (N,) or None, which leaves the facing free.
    """

    first_frame: int
    positions_m: NDArray[np.float32]
    headings_rad: NDArray[np.float32] | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("first_frame", self.first_frame)
        positions = as_array("positions_m", self.positions_m, (None, 2))
        if len(positions) == 0:
            raise InvalidInput("positions_m", "no position", "one x, z pair or more")
        object.__setattr__(self, "positions_m", positions)
        if self.headings_rad is not None:
            object.__setattr__(self, "headings_rad", as_array("headings_rad", self.headings_rad, (len(positions),)))


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A whole pose at one frame. positions_m: (J, 3) world position of every joint of the rig, metres."""

    frame: int
    positions_m: NDArray[np.float32]
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        object.__setattr__(self, "positions_m", as_array("positions_m", self.positions_m, (None, 3)))


@dataclass(frozen=True, eq=False)
class JointTargets:
    """World targets for some joints (hands, feet) at one frame. Without joint 0, the root, that comes along as needed.

    joints: K indices into the rig; positions_m: (K, 3) metres; rotations_quat_wxyz: (K, 4) unit quaternions or None.
    """

    frame: int
    joints: Sequence[int]
    positions_m: NDArray[np.float32]
    rotations_quat_wxyz: NDArray[np.float32] | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        object.__setattr__(self, "joints", tuple(self.joints))
        if not self.joints:
            raise InvalidInput("joints", self.joints, "one index of the rig's joints or more")
        positions = as_array("positions_m", self.positions_m, (len(self.joints), 3))
        object.__setattr__(self, "positions_m", positions)
        if self.rotations_quat_wxyz is not None:
            rotations = as_array("rotations_quat_wxyz", self.rotations_quat_wxyz, (len(self.joints), 4))
            object.__setattr__(self, "rotations_quat_wxyz", rotations)


@dataclass(frozen=True)
class HeadingTarget:
    """Where the root faces at one frame, wherever it is: radians, 0 faces +Z."""

    frame: int
    heading_rad: float
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        check_finite("heading_rad", self.heading_rad)


@dataclass(frozen=True, eq=False)
class JointRotations:
    """How some joints are turned at one frame, wherever they are.

    joints: K indices into the rig; rotations_quat_wxyz: (K, 4) unit quaternions of the world.
    """

    frame: int
    joints: Sequence[int]
    rotations_quat_wxyz: NDArray[np.float32]
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        object.__setattr__(self, "joints", tuple(self.joints))
        if not self.joints:
            raise InvalidInput("joints", self.joints, "one index of the rig's joints or more")
        rotations = as_array("rotations_quat_wxyz", self.rotations_quat_wxyz, (len(self.joints), 4))
        object.__setattr__(self, "rotations_quat_wxyz", rotations)


@dataclass(frozen=True, eq=False)
class RootPath:
    """Corners of a way over the ground, to be walked from where the character is when it takes effect.

    corners_m: (N, 2) world x, z in metres. speed_mps: where it is straight. smoothing_m: corners are cut so far.
    """

    corners_m: NDArray[np.float32]
    speed_mps: float | None = None
    smoothing_m: float | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        corners = as_array("corners_m", self.corners_m, (None, 2))
        if len(corners) == 0:
            raise InvalidInput("corners_m", "no corner", "one x, z pair or more")
        object.__setattr__(self, "corners_m", corners)
        for name in ("speed_mps", "smoothing_m"):
            if getattr(self, name) is not None:
                check_finite(name, getattr(self, name))


Target = Waypoint | RootTrajectory | Keyframe | JointTargets | HeadingTarget | JointRotations | RootPath


@dataclass(frozen=True)
class Flexible:
    """A target that leaves something to the server; `Outcome.placements` tells where it was put.

    last_frame: it may be met at any frame from the target's own to this one. at_any_frame: as soon as a person can be
    there, and the target's frame is 0. frames_from_effect: frames count from when the change takes effect. is_relative:
    places and angles are seen from the character then, x to its left, z ahead. weight: above 0, at most 10; 1 is what
    must be, and less is what should be where nothing heavier stands against it.
    """

    target: Target
    last_frame: int | None = None
    at_any_frame: bool = False
    frames_from_effect: bool = False
    is_relative: bool = False
    weight: float | None = None

    def __post_init__(self) -> None:
        if self.last_frame is not None:
            check_frame("last_frame", self.last_frame)
        if self.weight is not None and not 0 < self.weight <= 10:
            raise InvalidInput("weight", self.weight, "a number above 0, at most 10, or None for 1")


Constraint = Target | Flexible


@dataclass(frozen=True)
class Placement:
    """Where a constraint was put that left that to the server.

    arrival_frame: the one that is aimed for, between the first and the last at which it may be met. anchor_frame: when
    it takes effect; anchor_x_m, anchor_z_m, anchor_heading_rad: the character just before.
    """

    constraint_id: int
    first_frame: int
    last_frame: int
    arrival_frame: int
    anchor_frame: int
    anchor_x_m: float
    anchor_z_m: float
    anchor_heading_rad: float


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
    """What a session is opened with; None and "" leave a choice to the server.

    seed: same seed and same events at the same frames give the same motion. lookahead_frames: how far ahead of the
    playhead the server may send. denoise_steps: fewer are faster, more are finer. text_guidance and
    constraint_guidance: how strongly prompt and constraints are followed, 0 not at all. history_frames: how many frames
    each window sees before it. prior: what the character did just before frame 0, in place of `start`. keep_prompts:
    they hold also where constraints ask for a pace that they contradict; else the model walks someone who stands.
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

    def __post_init__(self) -> None:
        if self.prior is not None and self.start != StartPose():
            raise InvalidInput("start", self.start, "none beside prior, whose last frame is where the character starts")
        if self.seed is not None and not 0 <= self.seed < 1 << 64:
            raise InvalidInput("seed", self.seed, "a whole number from 0 to 2**64 - 1")
        for name in ("lookahead_frames", "denoise_steps", "history_frames"):
            value = getattr(self, name)
            if value is not None and not 1 <= value < 1 << 32:
                raise InvalidInput(name, value, "a whole number of 1 or more, or None for the server's default")
        for name in ("text_guidance", "constraint_guidance"):
            if getattr(self, name) is not None:
                check_finite(name, getattr(self, name))


@dataclass(frozen=True)
class ModelWarning:
    """What was taken although the model was not trained for it: the motion may not show it.

    reason: PROMPT_OUTSIDE_DOMAIN or UNTRAINED_CONSTRAINT; message: for people; field: where it was in the message.
    """

    reason: str
    message: str
    field: str


@dataclass(frozen=True)
class Opened:
    """What the server chose for a session. warnings: of its first prompts and constraints; placements: of these."""

    session_id: str
    seed: int
    start_frame: int
    rig_id: str
    model_id: str
    frame_rate_hz: int
    lookahead_frames: int
    committed_horizon_frames: int
    denoise_steps: int
    warnings: tuple[ModelWarning, ...] = ()
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """The answer to an accepted event. effective_frame: first frame it shows at; None when it alters no frame.

    warnings: of what was taken, but may not come out as asked. placements: of constraints that are `Flexible`.
    """

    event_seq: int
    effective_frame: int | None
    warnings: tuple[ModelWarning, ...] = ()
    placements: tuple[Placement, ...] = ()


@dataclass(frozen=True)
class Reopened:
    """A session that could not be resumed was opened anew, with the last frames as its history.

    frame: the first that the new session made, counted on from those before. The motion goes on from the same pose,
    with the same prompts and constraints, but is not what the lost session would have made. reason: why, in words.
    """

    frame: int
    reason: str


@dataclass(frozen=True)
class ServiceLevel:
    """How well a session is served. tier: full, fewer_steps, no_guidance or hold; denoise_steps: of each window."""

    tier: str
    denoise_steps: int


@dataclass(frozen=True)
class ConstraintReached:
    """What became of a constraint, told when its last frame cannot change any more.

    met: whether every error is within its tolerance. position_error_m: the worst distance, metres; rotation_error_rad:
    the worst angle between headings or rotations, 0 to pi. None: it asks for nothing of that kind.
    """

    constraint_id: int
    met: bool
    frame: int
    position_error_m: float | None
    rotation_error_rad: float | None


@dataclass(frozen=True)
class Deviation:
    """The mean and the worst of one kind of error."""

    mean: float
    worst: float


@dataclass(frozen=True)
class Residual:
    """How far a clip is from what one constraint asks for. None: it asks for nothing of that kind.

    num_frames: of the constraint, in the clip. heading_rad and rotation_rad are angles from 0 to pi. met: whether the
    worst of each kind is within its tolerance.
    """

    num_frames: int
    position_m: Deviation | None
    heading_rad: Deviation | None
    rotation_rad: Deviation | None
    met: bool = False


@dataclass(frozen=True, eq=False)
class Clip:
    """One sample of a clip. residuals: one for each constraint, in the order they were given.

    warnings: of prompts and constraints that the model was not trained for.
    """

    model_id: str
    seed: int
    denoise_steps: int
    motion: Motion
    residuals: tuple[Residual, ...]
    warnings: tuple[ModelWarning, ...] = ()


@dataclass(frozen=True)
class SessionEnd:
    """How a session ended. frames: sent in all; late_frames: sent after the playhead had reached them."""

    reason: str
    message: str
    frames: int
    late_frames: int


@dataclass(frozen=True)
class LocomotionPreset:
    """The prompt that holds while a velocity of from_speed_mps or more leads in a direction, seen from the heading."""

    name: str
    text: str
    from_speed_mps: float
    direction: str


@dataclass(frozen=True)
class Model:
    """A motion generator of the catalogue; durations are frames of its rig.

    text_width: numbers in a TextEmbedding for it. presets: the texts of prompts that a `Preset` can name, by their ids;
    preset_descriptions: the motion to expect of them, where it is told. constraint_forms: by name "trained",
    "untrained" (taken with a warning) or "refused"; empty where nothing is claimed. known_motions: what its training
    captions are about, in words. default_tolerance_m, default_tolerance_rad: of constraints that do not say.
    """

    model_id: str
    rig_id: str
    licence: str
    horizon_frames: int
    patch_frames: int
    future_frames: int
    default_denoise_steps: int
    min_denoise_steps: int
    max_denoise_steps: int
    text_encoder: str
    text_width: int
    presets: Mapping[str, str]
    num_parameters: int
    default_history_frames: int
    max_history_frames: int
    preset_descriptions: Mapping[str, str] = field(default_factory=dict)
    constraint_forms: Mapping[str, str] = field(default_factory=dict)
    locomotion_presets: tuple[LocomotionPreset, ...] = ()
    known_motions: tuple[str, ...] = ()
    default_tolerance_m: float = 0.0
    default_tolerance_rad: float = 0.0


@dataclass(frozen=True)
class Limits:
    """What a client must keep to."""

    max_sessions_per_stream: int
    max_constraints: int
    max_prompts: int
    max_prompt_characters: int
    max_trajectory_frames: int
    max_request_bytes: int
    default_lookahead_frames: int
    max_lookahead_frames: int
    max_coordinate_m: float
    max_guidance: float
    max_events_per_second: float
    max_stream_events_per_second: float
    max_speed_mps: float
    max_hold_frames: int
    max_clip_frames: int
    max_clip_samples: int


@dataclass(frozen=True)
class Catalog:
    """What a server offers; models[0] is its default."""

    etag: str
    rigs: tuple[Rig, ...]
    models: tuple[Model, ...]
    limits: Limits

    def rig(self, rig_id: str) -> Rig:
        """The rig with a name. Raises UnknownName, which lists the rigs there are."""
        for rig in self.rigs:
            if rig.rig_id == rig_id:
                return rig
        raise UnknownName("rig", rig_id, [rig.rig_id for rig in self.rigs])

    def model(self, model_id: str) -> Model:
        """The model with a name. Raises UnknownName, which lists the models there are."""
        for model in self.models:
            if model.model_id == model_id:
                return model
        raise UnknownName("model", model_id, [model.model_id for model in self.models])


def check_tolerance(tolerance_m: float | None, tolerance_rad: float | None) -> None:
    """Raise InvalidInput unless both are numbers that may be, or None."""
    if tolerance_m is not None and not (np.isfinite(tolerance_m) and tolerance_m >= 0):
        raise InvalidInput("tolerance_m", tolerance_m, "finite metres, 0 or more, or None")
    if tolerance_rad is not None and not 0 <= tolerance_rad <= np.pi:
        raise InvalidInput("tolerance_rad", tolerance_rad, "radians, 0 to pi, or None")


def check_finite(name: str, value: float) -> None:
    """Raise InvalidInput unless `value` is a finite number."""
    if not isinstance(value, int | float | np.number) or not np.isfinite(value):
        raise InvalidInput(name, value, "a finite number")


def check_frame(name: str, value: int) -> None:
    """Raise InvalidInput unless `value` is a frame index."""
    if not isinstance(value, int | np.integer) or value < 0:
        raise InvalidInput(name, value, "a frame index: a whole number of 0 or more")


def as_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float32]:
    """`values` as finite float32 of a shape, None standing for any length. Raises InvalidInput."""
    wanted = "(" + ", ".join("N" if size is None else str(size) for size in shape) + ")"
    allowed = f"finite numbers of shape {wanted}"
    try:
        array = np.asarray(values, dtype=np.float32)
    except (TypeError, ValueError):
        raise InvalidInput(name, values, allowed) from None
    fits = array.ndim == len(shape) and all(w in (None, s) for w, s in zip(shape, array.shape, strict=True))
    if not fits:
        raise InvalidInput(name, f"shape {array.shape}", allowed)
    if not np.isfinite(array).all():
        raise InvalidInput(name, "a number that is not finite", allowed)
    return array
