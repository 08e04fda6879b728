from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ScalarType(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCALAR_TYPE_UNSPECIFIED: _ClassVar[ScalarType]
    SCALAR_TYPE_F32_LE: _ClassVar[ScalarType]
    SCALAR_TYPE_F16_LE: _ClassVar[ScalarType]
    SCALAR_TYPE_QUANTISED: _ClassVar[ScalarType]
SCALAR_TYPE_UNSPECIFIED: ScalarType
SCALAR_TYPE_F32_LE: ScalarType
SCALAR_TYPE_F16_LE: ScalarType
SCALAR_TYPE_QUANTISED: ScalarType

class Rig(_message.Message):
    __slots__ = ("rig_id", "joints", "parents", "frame_rate", "blocks", "neutral_offsets_m", "hip_joints", "limbs")
    RIG_ID_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    PARENTS_FIELD_NUMBER: _ClassVar[int]
    FRAME_RATE_FIELD_NUMBER: _ClassVar[int]
    BLOCKS_FIELD_NUMBER: _ClassVar[int]
    NEUTRAL_OFFSETS_M_FIELD_NUMBER: _ClassVar[int]
    HIP_JOINTS_FIELD_NUMBER: _ClassVar[int]
    LIMBS_FIELD_NUMBER: _ClassVar[int]
    rig_id: str
    joints: _containers.RepeatedScalarFieldContainer[str]
    parents: _containers.RepeatedScalarFieldContainer[int]
    frame_rate: int
    blocks: _containers.RepeatedCompositeFieldContainer[ChannelBlock]
    neutral_offsets_m: _containers.RepeatedScalarFieldContainer[float]
    hip_joints: _containers.RepeatedScalarFieldContainer[int]
    limbs: _containers.RepeatedCompositeFieldContainer[Limb]
    def __init__(self, rig_id: _Optional[str] = ..., joints: _Optional[_Iterable[str]] = ..., parents: _Optional[_Iterable[int]] = ..., frame_rate: _Optional[int] = ..., blocks: _Optional[_Iterable[_Union[ChannelBlock, _Mapping]]] = ..., neutral_offsets_m: _Optional[_Iterable[float]] = ..., hip_joints: _Optional[_Iterable[int]] = ..., limbs: _Optional[_Iterable[_Union[Limb, _Mapping]]] = ...) -> None: ...

class Limb(_message.Message):
    __slots__ = ("name", "joints")
    NAME_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    name: str
    joints: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, name: _Optional[str] = ..., joints: _Optional[_Iterable[int]] = ...) -> None: ...

class ChannelBlock(_message.Message):
    __slots__ = ("name", "width")
    NAME_FIELD_NUMBER: _ClassVar[int]
    WIDTH_FIELD_NUMBER: _ClassVar[int]
    name: str
    width: int
    def __init__(self, name: _Optional[str] = ..., width: _Optional[int] = ...) -> None: ...

class PromptSpan(_message.Message):
    __slots__ = ("prompt_id", "start_frame", "end_frame", "text", "preset_id", "embedding")
    PROMPT_ID_FIELD_NUMBER: _ClassVar[int]
    START_FRAME_FIELD_NUMBER: _ClassVar[int]
    END_FRAME_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    PRESET_ID_FIELD_NUMBER: _ClassVar[int]
    EMBEDDING_FIELD_NUMBER: _ClassVar[int]
    prompt_id: int
    start_frame: int
    end_frame: int
    text: str
    preset_id: str
    embedding: TextEmbedding
    def __init__(self, prompt_id: _Optional[int] = ..., start_frame: _Optional[int] = ..., end_frame: _Optional[int] = ..., text: _Optional[str] = ..., preset_id: _Optional[str] = ..., embedding: _Optional[_Union[TextEmbedding, _Mapping]] = ...) -> None: ...

class TextEmbedding(_message.Message):
    __slots__ = ("text_encoder", "values")
    TEXT_ENCODER_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    text_encoder: str
    values: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, text_encoder: _Optional[str] = ..., values: _Optional[_Iterable[float]] = ...) -> None: ...

class Constraint(_message.Message):
    __slots__ = ("constraint_id", "frame", "last_frame", "frames_from_effect", "at_any_frame", "weight", "tolerance_m", "tolerance_rad", "waypoint", "joint_targets", "keyframe", "root_trajectory", "heading", "joint_rotations", "root_path", "foot_contact", "relative_to_character")
    CONSTRAINT_ID_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    LAST_FRAME_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FROM_EFFECT_FIELD_NUMBER: _ClassVar[int]
    AT_ANY_FRAME_FIELD_NUMBER: _ClassVar[int]
    WEIGHT_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_M_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_RAD_FIELD_NUMBER: _ClassVar[int]
    WAYPOINT_FIELD_NUMBER: _ClassVar[int]
    JOINT_TARGETS_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    ROOT_TRAJECTORY_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    JOINT_ROTATIONS_FIELD_NUMBER: _ClassVar[int]
    ROOT_PATH_FIELD_NUMBER: _ClassVar[int]
    FOOT_CONTACT_FIELD_NUMBER: _ClassVar[int]
    RELATIVE_TO_CHARACTER_FIELD_NUMBER: _ClassVar[int]
    constraint_id: int
    frame: int
    last_frame: int
    frames_from_effect: bool
    at_any_frame: bool
    weight: float
    tolerance_m: float
    tolerance_rad: float
    waypoint: Waypoint
    joint_targets: JointTargets
    keyframe: Keyframe
    root_trajectory: RootTrajectory
    heading: HeadingTarget
    joint_rotations: JointRotations
    root_path: RootPath
    foot_contact: FootContact
    relative_to_character: bool
    def __init__(self, constraint_id: _Optional[int] = ..., frame: _Optional[int] = ..., last_frame: _Optional[int] = ..., frames_from_effect: bool = ..., at_any_frame: bool = ..., weight: _Optional[float] = ..., tolerance_m: _Optional[float] = ..., tolerance_rad: _Optional[float] = ..., waypoint: _Optional[_Union[Waypoint, _Mapping]] = ..., joint_targets: _Optional[_Union[JointTargets, _Mapping]] = ..., keyframe: _Optional[_Union[Keyframe, _Mapping]] = ..., root_trajectory: _Optional[_Union[RootTrajectory, _Mapping]] = ..., heading: _Optional[_Union[HeadingTarget, _Mapping]] = ..., joint_rotations: _Optional[_Union[JointRotations, _Mapping]] = ..., root_path: _Optional[_Union[RootPath, _Mapping]] = ..., foot_contact: _Optional[_Union[FootContact, _Mapping]] = ..., relative_to_character: bool = ...) -> None: ...

class Waypoint(_message.Message):
    __slots__ = ("x", "z", "heading")
    X_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    x: float
    z: float
    heading: float
    def __init__(self, x: _Optional[float] = ..., z: _Optional[float] = ..., heading: _Optional[float] = ...) -> None: ...

class JointTargets(_message.Message):
    __slots__ = ("joints", "positions", "rotations")
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    ROTATIONS_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.RepeatedScalarFieldContainer[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    rotations: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, joints: _Optional[_Iterable[int]] = ..., positions: _Optional[_Iterable[float]] = ..., rotations: _Optional[_Iterable[float]] = ...) -> None: ...

class Keyframe(_message.Message):
    __slots__ = ("positions",)
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, positions: _Optional[_Iterable[float]] = ...) -> None: ...

class RootTrajectory(_message.Message):
    __slots__ = ("positions", "headings")
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    HEADINGS_FIELD_NUMBER: _ClassVar[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    headings: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, positions: _Optional[_Iterable[float]] = ..., headings: _Optional[_Iterable[float]] = ...) -> None: ...

class HeadingTarget(_message.Message):
    __slots__ = ("heading",)
    HEADING_FIELD_NUMBER: _ClassVar[int]
    heading: float
    def __init__(self, heading: _Optional[float] = ...) -> None: ...

class JointRotations(_message.Message):
    __slots__ = ("joints", "rotations")
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    ROTATIONS_FIELD_NUMBER: _ClassVar[int]
    joints: _containers.RepeatedScalarFieldContainer[int]
    rotations: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, joints: _Optional[_Iterable[int]] = ..., rotations: _Optional[_Iterable[float]] = ...) -> None: ...

class FootContact(_message.Message):
    __slots__ = ("limb", "x", "z", "heading")
    LIMB_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    limb: str
    x: float
    z: float
    heading: float
    def __init__(self, limb: _Optional[str] = ..., x: _Optional[float] = ..., z: _Optional[float] = ..., heading: _Optional[float] = ...) -> None: ...

class RootPath(_message.Message):
    __slots__ = ("positions", "speed_mps", "smoothing_m")
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPS_FIELD_NUMBER: _ClassVar[int]
    SMOOTHING_M_FIELD_NUMBER: _ClassVar[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    speed_mps: float
    smoothing_m: float
    def __init__(self, positions: _Optional[_Iterable[float]] = ..., speed_mps: _Optional[float] = ..., smoothing_m: _Optional[float] = ...) -> None: ...

class ConstraintPlacement(_message.Message):
    __slots__ = ("constraint_id", "first_frame", "last_frame", "arrival_frame", "anchor_frame", "anchor_x", "anchor_z", "anchor_heading")
    CONSTRAINT_ID_FIELD_NUMBER: _ClassVar[int]
    FIRST_FRAME_FIELD_NUMBER: _ClassVar[int]
    LAST_FRAME_FIELD_NUMBER: _ClassVar[int]
    ARRIVAL_FRAME_FIELD_NUMBER: _ClassVar[int]
    ANCHOR_FRAME_FIELD_NUMBER: _ClassVar[int]
    ANCHOR_X_FIELD_NUMBER: _ClassVar[int]
    ANCHOR_Z_FIELD_NUMBER: _ClassVar[int]
    ANCHOR_HEADING_FIELD_NUMBER: _ClassVar[int]
    constraint_id: int
    first_frame: int
    last_frame: int
    arrival_frame: int
    anchor_frame: int
    anchor_x: float
    anchor_z: float
    anchor_heading: float
    def __init__(self, constraint_id: _Optional[int] = ..., first_frame: _Optional[int] = ..., last_frame: _Optional[int] = ..., arrival_frame: _Optional[int] = ..., anchor_frame: _Optional[int] = ..., anchor_x: _Optional[float] = ..., anchor_z: _Optional[float] = ..., anchor_heading: _Optional[float] = ...) -> None: ...

class FrameChunk(_message.Message):
    __slots__ = ("plan", "first_frame", "frame_count", "committed_to", "data", "scalar_type", "root_origin_m")
    PLAN_FIELD_NUMBER: _ClassVar[int]
    FIRST_FRAME_FIELD_NUMBER: _ClassVar[int]
    FRAME_COUNT_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_TO_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    SCALAR_TYPE_FIELD_NUMBER: _ClassVar[int]
    ROOT_ORIGIN_M_FIELD_NUMBER: _ClassVar[int]
    plan: int
    first_frame: int
    frame_count: int
    committed_to: int
    data: bytes
    scalar_type: ScalarType
    root_origin_m: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, plan: _Optional[int] = ..., first_frame: _Optional[int] = ..., frame_count: _Optional[int] = ..., committed_to: _Optional[int] = ..., data: _Optional[bytes] = ..., scalar_type: _Optional[_Union[ScalarType, str]] = ..., root_origin_m: _Optional[_Iterable[float]] = ...) -> None: ...
