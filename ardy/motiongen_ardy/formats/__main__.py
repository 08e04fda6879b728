"""`python -m motiongen_ardy.formats IN OUT`: convert a motion file to another format."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from motiongen_ardy.core.output import command
from motiongen_ardy.core.skeleton import load_skeleton, skeleton_names
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.files import MOTION_FORMATS, ReadOptions, format_of, read_motion, write_motion
from motiongen_ardy.formats.g1_csv import QPOS_FPS
from motiongen_ardy.robot.g1 import RobotError


def parser() -> argparse.ArgumentParser:
    listed = "\n".join(
        f"  {one.name:<18}*{one.suffix:<16}{one.about}{'' if one.read else ' (only written)'}" for one in MOTION_FORMATS
    )
    arguments = argparse.ArgumentParser(
        prog="python -m motiongen_ardy.formats",
        description="Convert a motion file to another format.",
        epilog=f"formats, by name and ending:\n{listed}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    arguments.add_argument("source", type=Path, metavar="IN", help="the file to read; its ending names its format")
    arguments.add_argument("target", type=Path, metavar="OUT", help="the file to write, likewise")
    names = [one.name for one in MOTION_FORMATS]
    arguments.add_argument("--from", dest="source_format", choices=names, help="format of IN, if its ending names none")
    arguments.add_argument("--to", dest="target_format", choices=names, help="format of OUT, likewise")
    arguments.add_argument("--skeleton", choices=skeleton_names(), help="skeleton of IN, if the file does not name it")
    arguments.add_argument("--fps", type=float, help=f"rows per second of a g1-csv IN (default {QPOS_FPS:g})")
    arguments.add_argument("--rate-hz", type=float, help="rows per second of a g1-controller-csv OUT (default IN's)")
    return arguments


def _check_rates(given: argparse.Namespace) -> None:
    """Raise FormatError for a rate that would be ignored."""
    for option, rate, path, name, only in (
        ("--fps", given.fps, given.source, given.source_format, "g1-csv"),
        ("--rate-hz", given.rate_hz, given.target, given.target_format, "g1-controller-csv"),
    ):
        found = format_of(path, name).name
        if rate is not None and found != only:
            raise FormatError(path, f"a file of {found}, which has the rate of its motion", f"leave out {option}")


def main(argv: list[str] | None = None) -> int:
    given = parser().parse_args(argv)
    out = sys.stderr if _is_standard_output(given.target) else sys.stdout  # the motion itself goes there
    try:
        _check_rates(given)
        fps = QPOS_FPS if given.fps is None else given.fps
        options = ReadOptions(load_skeleton(given.skeleton) if given.skeleton else None, fps)
        stored = read_motion(given.source, options, given.source_format)
        said = write_motion(given.target, stored, given.rate_hz, given.target_format)
    except (FormatError, RobotError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:  # without a name if the disk is full
        print(f"error: {error if error.filename else f'{given.target}: {error}'}", file=sys.stderr)
        return 1
    motion = stored.motion
    print(f"{given.target}: {motion.num_frames} frames of {stored.skeleton.name} at {motion.fps} a second", file=out)
    for line in said:
        print(f"  {line}", file=out)
    return 0


def _is_standard_output(path: Path) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(1))
    except OSError:  # there is none, or no such file yet
        return False


if __name__ == "__main__":
    sys.exit(command(main))
