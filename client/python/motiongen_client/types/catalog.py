"""What a server offers: models, rigs and limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from motiongen_client.errors import UnknownName
from motiongen_client.motion import Rig


@dataclass(frozen=True)
class LocomotionPreset:
    """The prompt in force while a velocity of from_speed_mps or more points in a direction relative to the heading.

    to_speed_mps: beyond it feet may glide, and the answer has a warning; 0 if no claim is made.
    """

    name: str
    text: str
    from_speed_mps: float
    direction: str
    to_speed_mps: float = 0.0


@dataclass(frozen=True)
class Model:
    """A motion model of the catalogue; durations are in frames of its rig.

    text_width: numbers in a TextEmbedding for it. presets: id -> text of the prompts that a `Preset` can name;
    preset_descriptions: id -> the motion to expect, if stated. constraint_forms: name -> "trained", "untrained"
    (accepted with a warning) or "refused"; empty if no claim is made. known_motions: the subjects of its training
    captions, in words. default_tolerance_m, default_tolerance_rad: for constraints without their own.
    default_text_guidance, default_constraint_guidance: for sessions without their own.
    outputs: name -> width of the additional outputs that `SessionOptions.outputs` can ask for.
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
    default_text_guidance: float = 1.0
    default_constraint_guidance: float = 1.0
    outputs: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Limits:
    """The limits that a client must respect."""

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
    max_held_trajectory_frames: int = 0


@dataclass(frozen=True)
class Catalog:
    """What a server offers; models[0] is its default.

    free_share: the share of the server's capacity, 0 to 1, that was free for new sessions when the catalogue was
    fetched; None if the server does not say. It is not a promise.
    """

    etag: str
    rigs: tuple[Rig, ...]
    models: tuple[Model, ...]
    limits: Limits
    free_share: float | None = None

    def rig(self, rig_id: str) -> Rig:
        """The rig of that id. Raises UnknownName, which lists the rigs."""
        for rig in self.rigs:
            if rig.rig_id == rig_id:
                return rig
        raise UnknownName("rig", rig_id, [rig.rig_id for rig in self.rigs])

    def model(self, model_id: str) -> Model:
        """The model of that id. Raises UnknownName, which lists the models."""
        for model in self.models:
            if model.model_id == model_id:
                return model
        raise UnknownName("model", model_id, [model.model_id for model in self.models])
