"""The values that cross the engine's border: a session's spec and events, the runner's jobs and results, and outputs.

Frozen dataclasses of numpy arrays and numbers. Units: metres, radians, seconds; right-handed, +Y up, +Z forward. A
frame is an absolute index since the session began, at the model's fps. Times (`_at`, `deadline`) are monotonic seconds
of one clock. Shapes: T frames, J joints, D features, K joints of one constraint, E width of an embedding.
"""

from motiongen_server.engine.types.arrays import (
    Float32Array,
)
from motiongen_server.engine.types.blocks import ChannelBlock
from motiongen_server.engine.types.conditions import (
    DEFAULT_TOLERANCE,
    VELOCITY_ID,
    Asked,
    Constraint,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Placement,
    Prompt,
    RootPath,
    RootTrajectory,
    Span,
    Tolerance,
    Unplaced,
    Waypoint,
)
from motiongen_server.engine.types.events import (
    UNTOLD,
    Close,
    Event,
    Open,
    Playhead,
    Resume,
    SaveAgain,
    Seek,
    SetConstraints,
    SetOptions,
    SetPlayState,
    SetPrompts,
    SetVelocity,
)
from motiongen_server.engine.types.facts import (
    Limb,
    ModelFacts,
    RigLayout,
)
from motiongen_server.engine.types.jobs import (
    RowStatus,
    WindowJob,
    WindowResult,
)
from motiongen_server.engine.types.locomotion import (
    Direction,
    Gait,
)
from motiongen_server.engine.types.names import (
    CloseReason,
    Code,
    PlanCause,
    PlayState,
    Priority,
    ServiceTier,
    SessionKey,
)
from motiongen_server.engine.types.outputs import (
    Chunk,
    Closed,
    ConstraintReached,
    Deviation,
    Durable,
    Opened,
    Outcome,
    Output,
    PlanNotice,
    Resumed,
    ServiceLevel,
    Warned,
)
from motiongen_server.engine.types.owner import (
    NOBODY,
    Owner,
    StepsOf,
)
from motiongen_server.engine.types.refusals import (
    EventRefused,
)
from motiongen_server.engine.types.snapshot import (
    AnnouncedPlan,
    GoingOn,
    HeldVelocity,
    SessionSnapshot,
    SnapshotTaken,
    UnansweredEdit,
)
from motiongen_server.engine.types.spec import (
    Guidance,
    SessionSpec,
    StartPose,
)

__all__ = [
    "UnansweredEdit",
    "SnapshotTaken",
    "SessionSnapshot",
    "HeldVelocity",
    "GoingOn",
    "AnnouncedPlan",
    "Durable",
    "DEFAULT_TOLERANCE",
    "NOBODY",
    "VELOCITY_ID",
    "Asked",
    "ChannelBlock",
    "Chunk",
    "Close",
    "CloseReason",
    "Closed",
    "Code",
    "Constraint",
    "ConstraintReached",
    "Deviation",
    "Direction",
    "Event",
    "EventRefused",
    "Float32Array",
    "Gait",
    "Guidance",
    "HeadingTarget",
    "JointRotations",
    "JointTargets",
    "Limb",
    "ModelFacts",
    "Open",
    "Opened",
    "Outcome",
    "Output",
    "Owner",
    "PlanCause",
    "PlanNotice",
    "Placement",
    "PlayState",
    "Playhead",
    "Keyframe",
    "Priority",
    "Prompt",
    "RigLayout",
    "RootPath",
    "RootTrajectory",
    "Waypoint",
    "RowStatus",
    "Seek",
    "ServiceLevel",
    "ServiceTier",
    "SessionKey",
    "SessionSpec",
    "SetConstraints",
    "SetOptions",
    "SetPlayState",
    "SetPrompts",
    "SetVelocity",
    "Span",
    "StartPose",
    "StepsOf",
    "Tolerance",
    "Unplaced",
    "Warned",
    "WindowJob",
    "WindowResult",
    "Resume",
    "Resumed",
    "SaveAgain",
    "UNTOLD",
]
