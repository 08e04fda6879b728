"""What a client sends and receives, as frozen dataclasses of numbers, strings and numpy arrays."""

from motiongen_client.types.answers import (
    ConstraintReached,
    ModelWarning,
    Opened,
    Outcome,
    Placement,
    Reopened,
    ServiceLevel,
    SessionEnd,
)
from motiongen_client.types.catalog import Catalog, Limits, LocomotionPreset, Model
from motiongen_client.types.checks import (
    as_array,
    as_tuple,
    check_finite,
    check_flag,
    check_frame,
    check_number,
    check_text,
    check_tolerance,
    check_type,
    check_whole,
)
from motiongen_client.types.clips import Clip, Deviation, Residual
from motiongen_client.types.constraints import (
    Constraint,
    Flexible,
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RootPath,
    RootTrajectory,
    Target,
    Waypoint,
    check_target,
)
from motiongen_client.types.options import NO_PROMPTS, FrameFormat, Priority, SessionOptions, StartPose

__all__ = [
    "Catalog", "Clip", "Constraint", "ConstraintReached", "Deviation", "Flexible", "FootContact", "FrameFormat",
    "HeadingTarget", "JointRotations", "JointTargets", "Keyframe", "Limits", "LocomotionPreset", "Model",
    "ModelWarning",    "NO_PROMPTS", "Opened", "Outcome", "Placement", "Priority", "Reopened", "Residual", "RootPath",
    "RootTrajectory", "ServiceLevel", "SessionEnd", "SessionOptions", "StartPose", "Target", "Waypoint", "as_array",
    "as_tuple", "check_finite", "check_flag", "check_frame", "check_number", "check_target", "check_text",
    "check_tolerance", "check_type", "check_whole",
]  # fmt: skip
