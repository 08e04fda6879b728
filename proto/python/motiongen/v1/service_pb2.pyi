from google.protobuf import duration_pb2 as _duration_pb2
from motiongen.v1 import motion_pb2 as _motion_pb2
from motiongen.v1 import session_pb2 as _session_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GoodbyeReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    GOODBYE_REASON_UNSPECIFIED: _ClassVar[GoodbyeReason]
    GOODBYE_REASON_DRAINING: _ClassVar[GoodbyeReason]
    GOODBYE_REASON_CREDENTIALS_EXPIRING: _ClassVar[GoodbyeReason]

class FormSupport(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FORM_SUPPORT_UNSPECIFIED: _ClassVar[FormSupport]
    FORM_SUPPORT_TRAINED: _ClassVar[FormSupport]
    FORM_SUPPORT_UNTRAINED: _ClassVar[FormSupport]
    FORM_SUPPORT_REFUSED: _ClassVar[FormSupport]
GOODBYE_REASON_UNSPECIFIED: GoodbyeReason
GOODBYE_REASON_DRAINING: GoodbyeReason
GOODBYE_REASON_CREDENTIALS_EXPIRING: GoodbyeReason
FORM_SUPPORT_UNSPECIFIED: FormSupport
FORM_SUPPORT_TRAINED: FormSupport
FORM_SUPPORT_UNTRAINED: FormSupport
FORM_SUPPORT_REFUSED: FormSupport

class GetCatalogRequest(_message.Message):
    __slots__ = ("catalog_etag",)
    CATALOG_ETAG_FIELD_NUMBER: _ClassVar[int]
    catalog_etag: str
    def __init__(self, catalog_etag: _Optional[str] = ...) -> None: ...

class GetCatalogResponse(_message.Message):
    __slots__ = ("catalog_etag", "rigs", "limits", "models", "free_share")
    CATALOG_ETAG_FIELD_NUMBER: _ClassVar[int]
    RIGS_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    MODELS_FIELD_NUMBER: _ClassVar[int]
    FREE_SHARE_FIELD_NUMBER: _ClassVar[int]
    catalog_etag: str
    rigs: _containers.RepeatedCompositeFieldContainer[_motion_pb2.Rig]
    limits: Limits
    models: _containers.RepeatedCompositeFieldContainer[Model]
    free_share: float
    def __init__(self, catalog_etag: _Optional[str] = ..., rigs: _Optional[_Iterable[_Union[_motion_pb2.Rig, _Mapping]]] = ..., limits: _Optional[_Union[Limits, _Mapping]] = ..., models: _Optional[_Iterable[_Union[Model, _Mapping]]] = ..., free_share: _Optional[float] = ...) -> None: ...

class Model(_message.Message):
    __slots__ = ("model_id", "rig_id", "licence", "horizon_frames", "patch_frames", "default_denoise_steps", "max_denoise_steps", "text_encoder", "default_guidance", "future_frames", "min_denoise_steps", "num_parameters", "default_history_frames", "max_history_frames", "text_width", "presets", "constraint_forms", "locomotion_presets", "known_motions", "default_tolerance_m", "default_tolerance_rad", "outputs")
    MODEL_ID_FIELD_NUMBER: _ClassVar[int]
    RIG_ID_FIELD_NUMBER: _ClassVar[int]
    LICENCE_FIELD_NUMBER: _ClassVar[int]
    HORIZON_FRAMES_FIELD_NUMBER: _ClassVar[int]
    PATCH_FRAMES_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    MAX_DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    TEXT_ENCODER_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_GUIDANCE_FIELD_NUMBER: _ClassVar[int]
    FUTURE_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MIN_DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    NUM_PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_HISTORY_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MAX_HISTORY_FRAMES_FIELD_NUMBER: _ClassVar[int]
    TEXT_WIDTH_FIELD_NUMBER: _ClassVar[int]
    PRESETS_FIELD_NUMBER: _ClassVar[int]
    CONSTRAINT_FORMS_FIELD_NUMBER: _ClassVar[int]
    LOCOMOTION_PRESETS_FIELD_NUMBER: _ClassVar[int]
    KNOWN_MOTIONS_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_TOLERANCE_RAD_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    model_id: str
    rig_id: str
    licence: str
    horizon_frames: int
    patch_frames: int
    default_denoise_steps: int
    max_denoise_steps: int
    text_encoder: str
    default_guidance: _session_pb2.Guidance
    future_frames: int
    min_denoise_steps: int
    num_parameters: int
    default_history_frames: int
    max_history_frames: int
    text_width: int
    presets: _containers.RepeatedCompositeFieldContainer[Preset]
    constraint_forms: _containers.RepeatedCompositeFieldContainer[ConstraintForm]
    locomotion_presets: _containers.RepeatedCompositeFieldContainer[LocomotionPreset]
    known_motions: _containers.RepeatedScalarFieldContainer[str]
    default_tolerance_m: float
    default_tolerance_rad: float
    outputs: _containers.RepeatedCompositeFieldContainer[_motion_pb2.ChannelBlock]
    def __init__(self, model_id: _Optional[str] = ..., rig_id: _Optional[str] = ..., licence: _Optional[str] = ..., horizon_frames: _Optional[int] = ..., patch_frames: _Optional[int] = ..., default_denoise_steps: _Optional[int] = ..., max_denoise_steps: _Optional[int] = ..., text_encoder: _Optional[str] = ..., default_guidance: _Optional[_Union[_session_pb2.Guidance, _Mapping]] = ..., future_frames: _Optional[int] = ..., min_denoise_steps: _Optional[int] = ..., num_parameters: _Optional[int] = ..., default_history_frames: _Optional[int] = ..., max_history_frames: _Optional[int] = ..., text_width: _Optional[int] = ..., presets: _Optional[_Iterable[_Union[Preset, _Mapping]]] = ..., constraint_forms: _Optional[_Iterable[_Union[ConstraintForm, _Mapping]]] = ..., locomotion_presets: _Optional[_Iterable[_Union[LocomotionPreset, _Mapping]]] = ..., known_motions: _Optional[_Iterable[str]] = ..., default_tolerance_m: _Optional[float] = ..., default_tolerance_rad: _Optional[float] = ..., outputs: _Optional[_Iterable[_Union[_motion_pb2.ChannelBlock, _Mapping]]] = ...) -> None: ...

class ConstraintForm(_message.Message):
    __slots__ = ("form", "support")
    FORM_FIELD_NUMBER: _ClassVar[int]
    SUPPORT_FIELD_NUMBER: _ClassVar[int]
    form: str
    support: FormSupport
    def __init__(self, form: _Optional[str] = ..., support: _Optional[_Union[FormSupport, str]] = ...) -> None: ...

class LocomotionPreset(_message.Message):
    __slots__ = ("name", "text", "from_speed_mps", "direction", "to_speed_mps")
    NAME_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    FROM_SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    TO_SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    name: str
    text: str
    from_speed_mps: float
    direction: str
    to_speed_mps: float
    def __init__(self, name: _Optional[str] = ..., text: _Optional[str] = ..., from_speed_mps: _Optional[float] = ..., direction: _Optional[str] = ..., to_speed_mps: _Optional[float] = ...) -> None: ...

class Preset(_message.Message):
    __slots__ = ("preset_id", "text", "description")
    PRESET_ID_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    DESCRIPTION_FIELD_NUMBER: _ClassVar[int]
    preset_id: str
    text: str
    description: str
    def __init__(self, preset_id: _Optional[str] = ..., text: _Optional[str] = ..., description: _Optional[str] = ...) -> None: ...

class Limits(_message.Message):
    __slots__ = ("max_sessions_per_stream", "max_constraints", "max_events_per_second", "max_lookahead_frames", "max_prompts", "max_prompt_characters", "max_request_bytes", "default_lookahead_frames", "max_trajectory_frames", "max_coordinate_m", "max_guidance", "max_stream_events_per_second", "max_speed_mps", "max_hold_frames", "max_clip_frames", "max_clip_samples", "resume_grace", "max_held_trajectory_frames")
    MAX_SESSIONS_PER_STREAM_FIELD_NUMBER: _ClassVar[int]
    MAX_CONSTRAINTS_FIELD_NUMBER: _ClassVar[int]
    MAX_EVENTS_PER_SECOND_FIELD_NUMBER: _ClassVar[int]
    MAX_LOOKAHEAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MAX_PROMPTS_FIELD_NUMBER: _ClassVar[int]
    MAX_PROMPT_CHARACTERS_FIELD_NUMBER: _ClassVar[int]
    MAX_REQUEST_BYTES_FIELD_NUMBER: _ClassVar[int]
    DEFAULT_LOOKAHEAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MAX_TRAJECTORY_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MAX_COORDINATE_M_FIELD_NUMBER: _ClassVar[int]
    MAX_GUIDANCE_FIELD_NUMBER: _ClassVar[int]
    MAX_STREAM_EVENTS_PER_SECOND_FIELD_NUMBER: _ClassVar[int]
    MAX_SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    MAX_HOLD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MAX_CLIP_FRAMES_FIELD_NUMBER: _ClassVar[int]
    MAX_CLIP_SAMPLES_FIELD_NUMBER: _ClassVar[int]
    RESUME_GRACE_FIELD_NUMBER: _ClassVar[int]
    MAX_HELD_TRAJECTORY_FRAMES_FIELD_NUMBER: _ClassVar[int]
    max_sessions_per_stream: int
    max_constraints: int
    max_events_per_second: float
    max_lookahead_frames: int
    max_prompts: int
    max_prompt_characters: int
    max_request_bytes: int
    default_lookahead_frames: int
    max_trajectory_frames: int
    max_coordinate_m: float
    max_guidance: float
    max_stream_events_per_second: float
    max_speed_mps: float
    max_hold_frames: int
    max_clip_frames: int
    max_clip_samples: int
    resume_grace: _duration_pb2.Duration
    max_held_trajectory_frames: int
    def __init__(self, max_sessions_per_stream: _Optional[int] = ..., max_constraints: _Optional[int] = ..., max_events_per_second: _Optional[float] = ..., max_lookahead_frames: _Optional[int] = ..., max_prompts: _Optional[int] = ..., max_prompt_characters: _Optional[int] = ..., max_request_bytes: _Optional[int] = ..., default_lookahead_frames: _Optional[int] = ..., max_trajectory_frames: _Optional[int] = ..., max_coordinate_m: _Optional[float] = ..., max_guidance: _Optional[float] = ..., max_stream_events_per_second: _Optional[float] = ..., max_speed_mps: _Optional[float] = ..., max_hold_frames: _Optional[int] = ..., max_clip_frames: _Optional[int] = ..., max_clip_samples: _Optional[int] = ..., resume_grace: _Optional[_Union[_duration_pb2.Duration, _Mapping]] = ..., max_held_trajectory_frames: _Optional[int] = ...) -> None: ...

class StreamMotionRequest(_message.Message):
    __slots__ = ("events", "hello", "ping")
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    HELLO_FIELD_NUMBER: _ClassVar[int]
    PING_FIELD_NUMBER: _ClassVar[int]
    events: _containers.RepeatedCompositeFieldContainer[_session_pb2.SessionEvent]
    hello: ClientHello
    ping: Ping
    def __init__(self, events: _Optional[_Iterable[_Union[_session_pb2.SessionEvent, _Mapping]]] = ..., hello: _Optional[_Union[ClientHello, _Mapping]] = ..., ping: _Optional[_Union[Ping, _Mapping]] = ...) -> None: ...

class StreamMotionResponse(_message.Message):
    __slots__ = ("updates", "hello", "pong", "goodbye")
    UPDATES_FIELD_NUMBER: _ClassVar[int]
    HELLO_FIELD_NUMBER: _ClassVar[int]
    PONG_FIELD_NUMBER: _ClassVar[int]
    GOODBYE_FIELD_NUMBER: _ClassVar[int]
    updates: _containers.RepeatedCompositeFieldContainer[_session_pb2.SessionUpdate]
    hello: ServerHello
    pong: Pong
    goodbye: Goodbye
    def __init__(self, updates: _Optional[_Iterable[_Union[_session_pb2.SessionUpdate, _Mapping]]] = ..., hello: _Optional[_Union[ServerHello, _Mapping]] = ..., pong: _Optional[_Union[Pong, _Mapping]] = ..., goodbye: _Optional[_Union[Goodbye, _Mapping]] = ...) -> None: ...

class GenerateClipRequest(_message.Message):
    __slots__ = ("open", "frame_count", "sample_count")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    FRAME_COUNT_FIELD_NUMBER: _ClassVar[int]
    SAMPLE_COUNT_FIELD_NUMBER: _ClassVar[int]
    open: _session_pb2.OpenSession
    frame_count: int
    sample_count: int
    def __init__(self, open: _Optional[_Union[_session_pb2.OpenSession, _Mapping]] = ..., frame_count: _Optional[int] = ..., sample_count: _Optional[int] = ...) -> None: ...

class GenerateClipResponse(_message.Message):
    __slots__ = ("sample", "opened", "chunk", "summary")
    SAMPLE_FIELD_NUMBER: _ClassVar[int]
    OPENED_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    sample: int
    opened: _session_pb2.SessionOpened
    chunk: _motion_pb2.FrameChunk
    summary: ClipSummary
    def __init__(self, sample: _Optional[int] = ..., opened: _Optional[_Union[_session_pb2.SessionOpened, _Mapping]] = ..., chunk: _Optional[_Union[_motion_pb2.FrameChunk, _Mapping]] = ..., summary: _Optional[_Union[ClipSummary, _Mapping]] = ...) -> None: ...

class ClipSummary(_message.Message):
    __slots__ = ("residuals",)
    RESIDUALS_FIELD_NUMBER: _ClassVar[int]
    residuals: _containers.RepeatedCompositeFieldContainer[ConstraintResidual]
    def __init__(self, residuals: _Optional[_Iterable[_Union[ConstraintResidual, _Mapping]]] = ...) -> None: ...

class ConstraintResidual(_message.Message):
    __slots__ = ("constraint_id", "frame_count", "position_m", "heading_rad", "rotation_rad", "met")
    CONSTRAINT_ID_FIELD_NUMBER: _ClassVar[int]
    FRAME_COUNT_FIELD_NUMBER: _ClassVar[int]
    POSITION_M_FIELD_NUMBER: _ClassVar[int]
    HEADING_RAD_FIELD_NUMBER: _ClassVar[int]
    ROTATION_RAD_FIELD_NUMBER: _ClassVar[int]
    MET_FIELD_NUMBER: _ClassVar[int]
    constraint_id: int
    frame_count: int
    position_m: Deviation
    heading_rad: Deviation
    rotation_rad: Deviation
    met: bool
    def __init__(self, constraint_id: _Optional[int] = ..., frame_count: _Optional[int] = ..., position_m: _Optional[_Union[Deviation, _Mapping]] = ..., heading_rad: _Optional[_Union[Deviation, _Mapping]] = ..., rotation_rad: _Optional[_Union[Deviation, _Mapping]] = ..., met: bool = ...) -> None: ...

class Deviation(_message.Message):
    __slots__ = ("mean", "worst")
    MEAN_FIELD_NUMBER: _ClassVar[int]
    WORST_FIELD_NUMBER: _ClassVar[int]
    mean: float
    worst: float
    def __init__(self, mean: _Optional[float] = ..., worst: _Optional[float] = ...) -> None: ...

class ClientHello(_message.Message):
    __slots__ = ("client_agent", "flush_interval")
    CLIENT_AGENT_FIELD_NUMBER: _ClassVar[int]
    FLUSH_INTERVAL_FIELD_NUMBER: _ClassVar[int]
    client_agent: str
    flush_interval: _duration_pb2.Duration
    def __init__(self, client_agent: _Optional[str] = ..., flush_interval: _Optional[_Union[_duration_pb2.Duration, _Mapping]] = ...) -> None: ...

class ServerHello(_message.Message):
    __slots__ = ("replica_id", "limits", "server_time_ns")
    REPLICA_ID_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    SERVER_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    replica_id: str
    limits: Limits
    server_time_ns: int
    def __init__(self, replica_id: _Optional[str] = ..., limits: _Optional[_Union[Limits, _Mapping]] = ..., server_time_ns: _Optional[int] = ...) -> None: ...

class Ping(_message.Message):
    __slots__ = ("client_time_ns", "round_trip")
    CLIENT_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    ROUND_TRIP_FIELD_NUMBER: _ClassVar[int]
    client_time_ns: int
    round_trip: _duration_pb2.Duration
    def __init__(self, client_time_ns: _Optional[int] = ..., round_trip: _Optional[_Union[_duration_pb2.Duration, _Mapping]] = ...) -> None: ...

class Pong(_message.Message):
    __slots__ = ("client_time_ns", "server_time_ns")
    CLIENT_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SERVER_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    client_time_ns: int
    server_time_ns: int
    def __init__(self, client_time_ns: _Optional[int] = ..., server_time_ns: _Optional[int] = ...) -> None: ...

class Goodbye(_message.Message):
    __slots__ = ("reason", "grace", "reconnect_after", "other_servers")
    REASON_FIELD_NUMBER: _ClassVar[int]
    GRACE_FIELD_NUMBER: _ClassVar[int]
    RECONNECT_AFTER_FIELD_NUMBER: _ClassVar[int]
    OTHER_SERVERS_FIELD_NUMBER: _ClassVar[int]
    reason: GoodbyeReason
    grace: _duration_pb2.Duration
    reconnect_after: _duration_pb2.Duration
    other_servers: _containers.RepeatedCompositeFieldContainer[_session_pb2.OtherServer]
    def __init__(self, reason: _Optional[_Union[GoodbyeReason, str]] = ..., grace: _Optional[_Union[_duration_pb2.Duration, _Mapping]] = ..., reconnect_after: _Optional[_Union[_duration_pb2.Duration, _Mapping]] = ..., other_servers: _Optional[_Iterable[_Union[_session_pb2.OtherServer, _Mapping]]] = ...) -> None: ...
