"""Robot: people's motion as joint angles of the Unitree G1, and a safe hold for its controller when frames stop."""

from motiongen_client.robot.g1 import HINGES, QPOS_WIDTH, QVEL_WIDTH, Hinge
from motiongen_client.robot.retarget import G1Motion, G1Retargeter
from motiongen_client.robot.safe_hold import HoldState, SafeHold

__all__ = ["HINGES", "QPOS_WIDTH", "QVEL_WIDTH", "G1Motion", "G1Retargeter", "Hinge", "HoldState", "SafeHold"]
