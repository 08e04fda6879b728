"""`python -m motiongen_ardy.robot > g1.xml`: the Unitree G1's kinematics as a model for MuJoCo."""

from __future__ import annotations

import argparse

from motiongen_ardy.robot.mjcf import g1_mjcf

if __name__ == "__main__":
    argparse.ArgumentParser(
        prog="python -m motiongen_ardy.robot",
        description="Print the Unitree G1's kinematics as a model for MuJoCo (MJCF).",
    ).parse_args()
    print(g1_mjcf())
