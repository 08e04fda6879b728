"""Python client of motiongen: create characters, direct them, and play the frames that come back.

    async with MotionClient("localhost:50051") as client:
        walker = await client.open(prompt="a person walks forward")
        async for frame in walker.frames(seconds=4):
            print(frame.time_s, frame.joint_positions_m()[0])

`motiongen_client.blocking` is the same without asyncio. Frames are numbered from 0 when a session opens, at the rig's
frame rate. Right-handed, +Y up, +Z forward, metres, seconds, radians, quaternions w, x, y, z.
"""

from motiongen_client.axes import GODOT, ROS, UNITY, UNREAL, Axes
from motiongen_client.channel import ChannelSettings
from motiongen_client.client import MotionClient
from motiongen_client.edit import Edit
from motiongen_client.errors import (
    DeadlineExceeded,
    EventRefused,
    InvalidInput,
    MissingExtra,
    MotiongenError,
    NotAllowed,
    OtherServer,
    ProtocolViolation,
    ServerUnavailable,
    SessionEnded,
    StreamLost,
    UnknownName,
)
from motiongen_client.line_policy import LinePolicy
from motiongen_client.motion import Frame, Motion, Rig
from motiongen_client.playback import Playback
from motiongen_client.prompts import Preset, TextEmbedding
from motiongen_client.session import Session, SessionStats
from motiongen_client.steering import camera_relative, drawn_corners, stick_velocity
from motiongen_client.stream import Stream
from motiongen_client.types import (
    Catalog,
    Clip,
    ConstraintReached,
    Deviation,
    Flexible,
    FootContact,
    FrameFormat,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Limits,
    LocomotionPreset,
    Model,
    ModelWarning,
    Opened,
    Outcome,
    Placement,
    Priority,
    Reopened,
    Residual,
    RootPath,
    RootTrajectory,
    ServiceLevel,
    SessionEnd,
    SessionOptions,
    StartPose,
    Waypoint,
)

__all__ = [
    "MotionClient", "Stream", "Session", "Edit", "SessionStats", "Playback",
    "ChannelSettings", "LinePolicy", "Reopened", "Frame", "Motion", "Rig",
    "Axes", "UNREAL", "UNITY", "GODOT", "ROS",
    "SessionOptions", "StartPose", "Priority", "Waypoint", "RootTrajectory", "Keyframe", "JointTargets",
    "HeadingTarget", "JointRotations", "RootPath", "FootContact", "Flexible", "Placement", "FrameFormat",
    "Preset", "TextEmbedding", "stick_velocity", "camera_relative", "drawn_corners",
    "Clip", "Residual", "Deviation", "Catalog", "Model", "Limits", "Opened", "Outcome", "ServiceLevel", "SessionEnd",
    "LocomotionPreset", "ModelWarning", "ConstraintReached",
    "MotiongenError", "InvalidInput", "UnknownName", "ServerUnavailable", "StreamLost", "SessionEnded",
    "EventRefused", "DeadlineExceeded", "ProtocolViolation", "MissingExtra", "NotAllowed", "OtherServer",
]  # fmt: skip
