"""Retarget: puts motion on a user's skeleton, by a joint map. Pure numpy."""

from motiongen_client.retarget.joint_map import JointMap, read_joint_map
from motiongen_client.retarget.retargeter import Retargeted, Retargeter
from motiongen_client.retarget.skeleton import UserSkeleton

__all__ = ["JointMap", "Retargeted", "Retargeter", "UserSkeleton", "read_joint_map"]
