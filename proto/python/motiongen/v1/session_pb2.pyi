from google.protobuf import duration_pb2 as _duration_pb2
from motiongen.v1 import motion_pb2 as _motion_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PriorityClass(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PRIORITY_CLASS_UNSPECIFIED: _ClassVar[PriorityClass]
    PRIORITY_CLASS_HERO: _ClassVar[PriorityClass]
    PRIORITY_CLASS_NEAR: _ClassVar[PriorityClass]
    PRIORITY_CLASS_CROWD: _ClassVar[PriorityClass]
    PRIORITY_CLASS_BATCH: _ClassVar[PriorityClass]

class PlayState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PLAY_STATE_UNSPECIFIED: _ClassVar[PlayState]
    PLAY_STATE_PLAYING: _ClassVar[PlayState]
    PLAY_STATE_PAUSED: _ClassVar[PlayState]

class PlanCause(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    PLAN_CAUSE_UNSPECIFIED: _ClassVar[PlanCause]
    PLAN_CAUSE_CONTINUE: _ClassVar[PlanCause]
    PLAN_CAUSE_EDIT: _ClassVar[PlanCause]
    PLAN_CAUSE_FALLBACK: _ClassVar[PlanCause]
    PLAN_CAUSE_RESUME: _ClassVar[PlanCause]
    PLAN_CAUSE_CUT: _ClassVar[PlanCause]

class ServiceTier(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SERVICE_TIER_UNSPECIFIED: _ClassVar[ServiceTier]
    SERVICE_TIER_FULL: _ClassVar[ServiceTier]
    SERVICE_TIER_FEWER_STEPS: _ClassVar[ServiceTier]
    SERVICE_TIER_NO_GUIDANCE: _ClassVar[ServiceTier]
    SERVICE_TIER_SMALL_MODEL: _ClassVar[ServiceTier]
    SERVICE_TIER_HOLD: _ClassVar[ServiceTier]

class CloseReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CLOSE_REASON_UNSPECIFIED: _ClassVar[CloseReason]
    CLOSE_REASON_CLIENT: _ClassVar[CloseReason]
    CLOSE_REASON_IDLE: _ClassVar[CloseReason]
    CLOSE_REASON_SLOW_READER: _ClassVar[CloseReason]
    CLOSE_REASON_DRAINED: _ClassVar[CloseReason]
    CLOSE_REASON_ENGINE_FAULT: _ClassVar[CloseReason]
    CLOSE_REASON_OVERLOAD: _ClassVar[CloseReason]
    CLOSE_REASON_MODEL_UNLOADED: _ClassVar[CloseReason]
    CLOSE_REASON_TAKEN_OVER: _ClassVar[CloseReason]
PRIORITY_CLASS_UNSPECIFIED: PriorityClass
PRIORITY_CLASS_HERO: PriorityClass
PRIORITY_CLASS_NEAR: PriorityClass
PRIORITY_CLASS_CROWD: PriorityClass
PRIORITY_CLASS_BATCH: PriorityClass
PLAY_STATE_UNSPECIFIED: PlayState
PLAY_STATE_PLAYING: PlayState
PLAY_STATE_PAUSED: PlayState
PLAN_CAUSE_UNSPECIFIED: PlanCause
PLAN_CAUSE_CONTINUE: PlanCause
PLAN_CAUSE_EDIT: PlanCause
PLAN_CAUSE_FALLBACK: PlanCause
PLAN_CAUSE_RESUME: PlanCause
PLAN_CAUSE_CUT: PlanCause
SERVICE_TIER_UNSPECIFIED: ServiceTier
SERVICE_TIER_FULL: ServiceTier
SERVICE_TIER_FEWER_STEPS: ServiceTier
SERVICE_TIER_NO_GUIDANCE: ServiceTier
SERVICE_TIER_SMALL_MODEL: ServiceTier
SERVICE_TIER_HOLD: ServiceTier
CLOSE_REASON_UNSPECIFIED: CloseReason
CLOSE_REASON_CLIENT: CloseReason
CLOSE_REASON_IDLE: CloseReason
CLOSE_REASON_SLOW_READER: CloseReason
CLOSE_REASON_DRAINED: CloseReason
CLOSE_REASON_ENGINE_FAULT: CloseReason
CLOSE_REASON_OVERLOAD: CloseReason
CLOSE_REASON_MODEL_UNLOADED: CloseReason
CLOSE_REASON_TAKEN_OVER: CloseReason

class SessionEvent(_message.Message):
    __slots__ = ("session", "event_seq", "open", "edit_prompts", "edit_constraints", "set_velocity", "playhead", "set_play_state", "close", "seek", "set_options", "take_snapshot")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    EVENT_SEQ_FIELD_NUMBER: _ClassVar[int]
    OPEN_FIELD_NUMBER: _ClassVar[int]
    EDIT_PROMPTS_FIELD_NUMBER: _ClassVar[int]
    EDIT_CONSTRAINTS_FIELD_NUMBER: _ClassVar[int]
    SET_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    PLAYHEAD_FIELD_NUMBER: _ClassVar[int]
    SET_PLAY_STATE_FIELD_NUMBER: _ClassVar[int]
    CLOSE_FIELD_NUMBER: _ClassVar[int]
    SEEK_FIELD_NUMBER: _ClassVar[int]
    SET_OPTIONS_FIELD_NUMBER: _ClassVar[int]
    TAKE_SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    session: int
    event_seq: int
    open: OpenSession
    edit_prompts: EditPrompts
    edit_constraints: EditConstraints
    set_velocity: SetVelocity
    playhead: Playhead
    set_play_state: SetPlayState
    close: CloseSession
    seek: Seek
    set_options: SetOptions
    take_snapshot: TakeSnapshot
    def __init__(self, session: _Optional[int] = ..., event_seq: _Optional[int] = ..., open: _Optional[_Union[OpenSession, _Mapping]] = ..., edit_prompts: _Optional[_Union[EditPrompts, _Mapping]] = ..., edit_constraints: _Optional[_Union[EditConstraints, _Mapping]] = ..., set_velocity: _Optional[_Union[SetVelocity, _Mapping]] = ..., playhead: _Optional[_Union[Playhead, _Mapping]] = ..., set_play_state: _Optional[_Union[SetPlayState, _Mapping]] = ..., close: _Optional[_Union[CloseSession, _Mapping]] = ..., seek: _Optional[_Union[Seek, _Mapping]] = ..., set_options: _Optional[_Union[SetOptions, _Mapping]] = ..., take_snapshot: _Optional[_Union[TakeSnapshot, _Mapping]] = ...) -> None: ...

class OpenSession(_message.Message):
    __slots__ = ("request_id", "rig_id", "model_id", "seed", "priority", "lookahead_frames", "prior_frames", "scalar_type", "prompts", "constraints", "start_pose", "denoise_steps", "guidance", "history_frames", "resume_token", "snapshot", "outputs", "keep_prompts", "resume_point")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    RIG_ID_FIELD_NUMBER: _ClassVar[int]
    MODEL_ID_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    LOOKAHEAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    PRIOR_FRAMES_FIELD_NUMBER: _ClassVar[int]
    SCALAR_TYPE_FIELD_NUMBER: _ClassVar[int]
    PROMPTS_FIELD_NUMBER: _ClassVar[int]
    CONSTRAINTS_FIELD_NUMBER: _ClassVar[int]
    START_POSE_FIELD_NUMBER: _ClassVar[int]
    DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    GUIDANCE_FIELD_NUMBER: _ClassVar[int]
    HISTORY_FRAMES_FIELD_NUMBER: _ClassVar[int]
    RESUME_TOKEN_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    KEEP_PROMPTS_FIELD_NUMBER: _ClassVar[int]
    RESUME_POINT_FIELD_NUMBER: _ClassVar[int]
    request_id: str
    rig_id: str
    model_id: str
    seed: int
    priority: PriorityClass
    lookahead_frames: int
    prior_frames: _motion_pb2.FrameChunk
    scalar_type: _motion_pb2.ScalarType
    prompts: _containers.RepeatedCompositeFieldContainer[_motion_pb2.PromptSpan]
    constraints: _containers.RepeatedCompositeFieldContainer[_motion_pb2.Constraint]
    start_pose: StartPose
    denoise_steps: int
    guidance: Guidance
    history_frames: int
    resume_token: str
    snapshot: bytes
    outputs: _containers.RepeatedScalarFieldContainer[str]
    keep_prompts: bool
    resume_point: ResumePoint
    def __init__(self, request_id: _Optional[str] = ..., rig_id: _Optional[str] = ..., model_id: _Optional[str] = ..., seed: _Optional[int] = ..., priority: _Optional[_Union[PriorityClass, str]] = ..., lookahead_frames: _Optional[int] = ..., prior_frames: _Optional[_Union[_motion_pb2.FrameChunk, _Mapping]] = ..., scalar_type: _Optional[_Union[_motion_pb2.ScalarType, str]] = ..., prompts: _Optional[_Iterable[_Union[_motion_pb2.PromptSpan, _Mapping]]] = ..., constraints: _Optional[_Iterable[_Union[_motion_pb2.Constraint, _Mapping]]] = ..., start_pose: _Optional[_Union[StartPose, _Mapping]] = ..., denoise_steps: _Optional[int] = ..., guidance: _Optional[_Union[Guidance, _Mapping]] = ..., history_frames: _Optional[int] = ..., resume_token: _Optional[str] = ..., snapshot: _Optional[bytes] = ..., outputs: _Optional[_Iterable[str]] = ..., keep_prompts: bool = ..., resume_point: _Optional[_Union[ResumePoint, _Mapping]] = ...) -> None: ...

class ResumePoint(_message.Message):
    __slots__ = ("next_frame", "plan", "answered_seq", "attempt", "playhead", "committed_to")
    NEXT_FRAME_FIELD_NUMBER: _ClassVar[int]
    PLAN_FIELD_NUMBER: _ClassVar[int]
    ANSWERED_SEQ_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    PLAYHEAD_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_TO_FIELD_NUMBER: _ClassVar[int]
    next_frame: int
    plan: int
    answered_seq: int
    attempt: int
    playhead: int
    committed_to: int
    def __init__(self, next_frame: _Optional[int] = ..., plan: _Optional[int] = ..., answered_seq: _Optional[int] = ..., attempt: _Optional[int] = ..., playhead: _Optional[int] = ..., committed_to: _Optional[int] = ...) -> None: ...

class StartPose(_message.Message):
    __slots__ = ("x", "z", "heading")
    X_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    x: float
    z: float
    heading: float
    def __init__(self, x: _Optional[float] = ..., z: _Optional[float] = ..., heading: _Optional[float] = ...) -> None: ...

class Guidance(_message.Message):
    __slots__ = ("text", "constraint")
    TEXT_FIELD_NUMBER: _ClassVar[int]
    CONSTRAINT_FIELD_NUMBER: _ClassVar[int]
    text: float
    constraint: float
    def __init__(self, text: _Optional[float] = ..., constraint: _Optional[float] = ...) -> None: ...

class EditPrompts(_message.Message):
    __slots__ = ("upsert", "remove")
    UPSERT_FIELD_NUMBER: _ClassVar[int]
    REMOVE_FIELD_NUMBER: _ClassVar[int]
    upsert: _containers.RepeatedCompositeFieldContainer[_motion_pb2.PromptSpan]
    remove: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, upsert: _Optional[_Iterable[_Union[_motion_pb2.PromptSpan, _Mapping]]] = ..., remove: _Optional[_Iterable[int]] = ...) -> None: ...

class EditConstraints(_message.Message):
    __slots__ = ("upsert", "remove", "clear")
    UPSERT_FIELD_NUMBER: _ClassVar[int]
    REMOVE_FIELD_NUMBER: _ClassVar[int]
    CLEAR_FIELD_NUMBER: _ClassVar[int]
    upsert: _containers.RepeatedCompositeFieldContainer[_motion_pb2.Constraint]
    remove: _containers.RepeatedScalarFieldContainer[int]
    clear: bool
    def __init__(self, upsert: _Optional[_Iterable[_Union[_motion_pb2.Constraint, _Mapping]]] = ..., remove: _Optional[_Iterable[int]] = ..., clear: bool = ...) -> None: ...

class SetVelocity(_message.Message):
    __slots__ = ("x", "z", "heading", "hold_frames", "keep_prompt")
    X_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    HOLD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    KEEP_PROMPT_FIELD_NUMBER: _ClassVar[int]
    x: float
    z: float
    heading: float
    hold_frames: int
    keep_prompt: bool
    def __init__(self, x: _Optional[float] = ..., z: _Optional[float] = ..., heading: _Optional[float] = ..., hold_frames: _Optional[int] = ..., keep_prompt: bool = ...) -> None: ...

class Playhead(_message.Message):
    __slots__ = ("frame", "buffered_to", "underruns", "answered_seq")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    BUFFERED_TO_FIELD_NUMBER: _ClassVar[int]
    UNDERRUNS_FIELD_NUMBER: _ClassVar[int]
    ANSWERED_SEQ_FIELD_NUMBER: _ClassVar[int]
    frame: int
    buffered_to: int
    underruns: int
    answered_seq: int
    def __init__(self, frame: _Optional[int] = ..., buffered_to: _Optional[int] = ..., underruns: _Optional[int] = ..., answered_seq: _Optional[int] = ...) -> None: ...

class SetPlayState(_message.Message):
    __slots__ = ("state",)
    STATE_FIELD_NUMBER: _ClassVar[int]
    state: PlayState
    def __init__(self, state: _Optional[_Union[PlayState, str]] = ...) -> None: ...

class Seek(_message.Message):
    __slots__ = ("frame", "start_pose", "prior_frames")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    START_POSE_FIELD_NUMBER: _ClassVar[int]
    PRIOR_FRAMES_FIELD_NUMBER: _ClassVar[int]
    frame: int
    start_pose: StartPose
    prior_frames: _motion_pb2.FrameChunk
    def __init__(self, frame: _Optional[int] = ..., start_pose: _Optional[_Union[StartPose, _Mapping]] = ..., prior_frames: _Optional[_Union[_motion_pb2.FrameChunk, _Mapping]] = ...) -> None: ...

class SetOptions(_message.Message):
    __slots__ = ("priority", "lookahead_frames", "denoise_steps", "guidance", "history_frames")
    PRIORITY_FIELD_NUMBER: _ClassVar[int]
    LOOKAHEAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    GUIDANCE_FIELD_NUMBER: _ClassVar[int]
    HISTORY_FRAMES_FIELD_NUMBER: _ClassVar[int]
    priority: PriorityClass
    lookahead_frames: int
    denoise_steps: int
    guidance: Guidance
    history_frames: int
    def __init__(self, priority: _Optional[_Union[PriorityClass, str]] = ..., lookahead_frames: _Optional[int] = ..., denoise_steps: _Optional[int] = ..., guidance: _Optional[_Union[Guidance, _Mapping]] = ..., history_frames: _Optional[int] = ...) -> None: ...

class TakeSnapshot(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class CloseSession(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class SessionUpdate(_message.Message):
    __slots__ = ("session", "applied_seq", "durable_seq", "opened", "chunk", "plan", "outcome", "service_level", "closed", "constraint_reached", "snapshot", "durability")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    APPLIED_SEQ_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQ_FIELD_NUMBER: _ClassVar[int]
    OPENED_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    PLAN_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    SERVICE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    CLOSED_FIELD_NUMBER: _ClassVar[int]
    CONSTRAINT_REACHED_FIELD_NUMBER: _ClassVar[int]
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    DURABILITY_FIELD_NUMBER: _ClassVar[int]
    session: int
    applied_seq: int
    durable_seq: int
    opened: SessionOpened
    chunk: _motion_pb2.FrameChunk
    plan: PlanNotice
    outcome: EditOutcome
    service_level: ServiceLevel
    closed: SessionClosed
    constraint_reached: ConstraintReached
    snapshot: SessionSnapshot
    durability: SessionDurability
    def __init__(self, session: _Optional[int] = ..., applied_seq: _Optional[int] = ..., durable_seq: _Optional[int] = ..., opened: _Optional[_Union[SessionOpened, _Mapping]] = ..., chunk: _Optional[_Union[_motion_pb2.FrameChunk, _Mapping]] = ..., plan: _Optional[_Union[PlanNotice, _Mapping]] = ..., outcome: _Optional[_Union[EditOutcome, _Mapping]] = ..., service_level: _Optional[_Union[ServiceLevel, _Mapping]] = ..., closed: _Optional[_Union[SessionClosed, _Mapping]] = ..., constraint_reached: _Optional[_Union[ConstraintReached, _Mapping]] = ..., snapshot: _Optional[_Union[SessionSnapshot, _Mapping]] = ..., durability: _Optional[_Union[SessionDurability, _Mapping]] = ...) -> None: ...

class SessionOpened(_message.Message):
    __slots__ = ("session_id", "seed", "start_frame", "rig_id", "model_id", "frame_rate", "lookahead_frames", "committed_horizon_frames", "denoise_steps", "scalar_type", "warnings", "session_token", "placements", "outputs")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    START_FRAME_FIELD_NUMBER: _ClassVar[int]
    RIG_ID_FIELD_NUMBER: _ClassVar[int]
    MODEL_ID_FIELD_NUMBER: _ClassVar[int]
    FRAME_RATE_FIELD_NUMBER: _ClassVar[int]
    LOOKAHEAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_HORIZON_FRAMES_FIELD_NUMBER: _ClassVar[int]
    DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    SCALAR_TYPE_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    SESSION_TOKEN_FIELD_NUMBER: _ClassVar[int]
    PLACEMENTS_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    seed: int
    start_frame: int
    rig_id: str
    model_id: str
    frame_rate: int
    lookahead_frames: int
    committed_horizon_frames: int
    denoise_steps: int
    scalar_type: _motion_pb2.ScalarType
    warnings: _containers.RepeatedCompositeFieldContainer[EventWarning]
    session_token: str
    placements: _containers.RepeatedCompositeFieldContainer[_motion_pb2.ConstraintPlacement]
    outputs: _containers.RepeatedCompositeFieldContainer[_motion_pb2.ChannelBlock]
    def __init__(self, session_id: _Optional[str] = ..., seed: _Optional[int] = ..., start_frame: _Optional[int] = ..., rig_id: _Optional[str] = ..., model_id: _Optional[str] = ..., frame_rate: _Optional[int] = ..., lookahead_frames: _Optional[int] = ..., committed_horizon_frames: _Optional[int] = ..., denoise_steps: _Optional[int] = ..., scalar_type: _Optional[_Union[_motion_pb2.ScalarType, str]] = ..., warnings: _Optional[_Iterable[_Union[EventWarning, _Mapping]]] = ..., session_token: _Optional[str] = ..., placements: _Optional[_Iterable[_Union[_motion_pb2.ConstraintPlacement, _Mapping]]] = ..., outputs: _Optional[_Iterable[_Union[_motion_pb2.ChannelBlock, _Mapping]]] = ...) -> None: ...

class PlanNotice(_message.Message):
    __slots__ = ("plan", "valid_from", "cause", "event_seqs")
    PLAN_FIELD_NUMBER: _ClassVar[int]
    VALID_FROM_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    EVENT_SEQS_FIELD_NUMBER: _ClassVar[int]
    plan: int
    valid_from: int
    cause: PlanCause
    event_seqs: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, plan: _Optional[int] = ..., valid_from: _Optional[int] = ..., cause: _Optional[_Union[PlanCause, str]] = ..., event_seqs: _Optional[_Iterable[int]] = ...) -> None: ...

class EditOutcome(_message.Message):
    __slots__ = ("event_seq", "code", "reason", "message", "effective_frame", "field", "allowed", "retry_after", "warnings", "spare_sessions", "placements", "other_servers")
    EVENT_SEQ_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    EFFECTIVE_FRAME_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    ALLOWED_FIELD_NUMBER: _ClassVar[int]
    RETRY_AFTER_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    SPARE_SESSIONS_FIELD_NUMBER: _ClassVar[int]
    PLACEMENTS_FIELD_NUMBER: _ClassVar[int]
    OTHER_SERVERS_FIELD_NUMBER: _ClassVar[int]
    event_seq: int
    code: int
    reason: str
    message: str
    effective_frame: int
    field: str
    allowed: str
    retry_after: _duration_pb2.Duration
    warnings: _containers.RepeatedCompositeFieldContainer[EventWarning]
    spare_sessions: int
    placements: _containers.RepeatedCompositeFieldContainer[_motion_pb2.ConstraintPlacement]
    other_servers: _containers.RepeatedCompositeFieldContainer[OtherServer]
    def __init__(self, event_seq: _Optional[int] = ..., code: _Optional[int] = ..., reason: _Optional[str] = ..., message: _Optional[str] = ..., effective_frame: _Optional[int] = ..., field: _Optional[str] = ..., allowed: _Optional[str] = ..., retry_after: _Optional[_Union[_duration_pb2.Duration, _Mapping]] = ..., warnings: _Optional[_Iterable[_Union[EventWarning, _Mapping]]] = ..., spare_sessions: _Optional[int] = ..., placements: _Optional[_Iterable[_Union[_motion_pb2.ConstraintPlacement, _Mapping]]] = ..., other_servers: _Optional[_Iterable[_Union[OtherServer, _Mapping]]] = ...) -> None: ...

class OtherServer(_message.Message):
    __slots__ = ("address", "routing_key")
    ADDRESS_FIELD_NUMBER: _ClassVar[int]
    ROUTING_KEY_FIELD_NUMBER: _ClassVar[int]
    address: str
    routing_key: str
    def __init__(self, address: _Optional[str] = ..., routing_key: _Optional[str] = ...) -> None: ...

class EventWarning(_message.Message):
    __slots__ = ("reason", "message", "field")
    REASON_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    reason: str
    message: str
    field: str
    def __init__(self, reason: _Optional[str] = ..., message: _Optional[str] = ..., field: _Optional[str] = ...) -> None: ...

class ConstraintReached(_message.Message):
    __slots__ = ("constraint_id", "met", "frame", "position_error_m", "rotation_error_rad")
    CONSTRAINT_ID_FIELD_NUMBER: _ClassVar[int]
    MET_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    POSITION_ERROR_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_ERROR_RAD_FIELD_NUMBER: _ClassVar[int]
    constraint_id: int
    met: bool
    frame: int
    position_error_m: float
    rotation_error_rad: float
    def __init__(self, constraint_id: _Optional[int] = ..., met: bool = ..., frame: _Optional[int] = ..., position_error_m: _Optional[float] = ..., rotation_error_rad: _Optional[float] = ...) -> None: ...

class SessionSnapshot(_message.Message):
    __slots__ = ("snapshot", "start_frame")
    SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    START_FRAME_FIELD_NUMBER: _ClassVar[int]
    snapshot: bytes
    start_frame: int
    def __init__(self, snapshot: _Optional[bytes] = ..., start_frame: _Optional[int] = ...) -> None: ...

class SessionDurability(_message.Message):
    __slots__ = ("is_kept",)
    IS_KEPT_FIELD_NUMBER: _ClassVar[int]
    is_kept: bool
    def __init__(self, is_kept: bool = ...) -> None: ...

class ServiceLevel(_message.Message):
    __slots__ = ("tier", "denoise_steps")
    TIER_FIELD_NUMBER: _ClassVar[int]
    DENOISE_STEPS_FIELD_NUMBER: _ClassVar[int]
    tier: ServiceTier
    denoise_steps: int
    def __init__(self, tier: _Optional[_Union[ServiceTier, str]] = ..., denoise_steps: _Optional[int] = ...) -> None: ...

class SessionClosed(_message.Message):
    __slots__ = ("reason", "code", "message", "frames", "late_frames")
    REASON_FIELD_NUMBER: _ClassVar[int]
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    LATE_FRAMES_FIELD_NUMBER: _ClassVar[int]
    reason: CloseReason
    code: int
    message: str
    frames: int
    late_frames: int
    def __init__(self, reason: _Optional[_Union[CloseReason, str]] = ..., code: _Optional[int] = ..., message: _Optional[str] = ..., frames: _Optional[int] = ..., late_frames: _Optional[int] = ...) -> None: ...
