"""`python -m motiongen_ardy.robot > g1.xml`: the Unitree G1's kinematics as a model for MuJoCo."""

from __future__ import annotations

import argparse
import sys

from motiongen_ardy.core.output import command
from motiongen_ardy.robot.mjcf import g1_mjcf


def main() -> None:
    """Command line."""
    argparse.ArgumentParser(
        prog="python -m motiongen_ardy.robot",
        description="Print the Unitree G1's kinematics as a model for MuJoCo (MJCF).",
    ).parse_args()
    print(g1_mjcf())


if __name__ == "__main__":
    sys.exit(command(main))
