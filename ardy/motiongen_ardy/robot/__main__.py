"""`python -m motiongen_ardy.robot > g1.xml`: the Unitree G1's kinematics as a model for MuJoCo."""

from __future__ import annotations

from motiongen_ardy.robot.mjcf import g1_mjcf

if __name__ == "__main__":
    print(g1_mjcf())
