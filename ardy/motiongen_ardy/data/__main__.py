"""Command line: ``python -m motiongen_ardy.data build | check | look``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from motiongen_ardy.checkpoint.config import MAX_FPS
from motiongen_ardy.core.output import command
from motiongen_ardy.core.skeleton import UnknownSkeleton, load_skeleton
from motiongen_ardy.data.build import BuildSettings, build, more_labels
from motiongen_ardy.data.dataset import DatasetError, MotionDataset, prepare_folder, skipped_clips
from motiongen_ardy.data.figures import figures_table, measure
from motiongen_ardy.data.kinds import kinds_table
from motiongen_ardy.data.labels import LabelsError, file_key, read_labels
from motiongen_ardy.data.retarget_file import built_in_retargets, read_retarget
from motiongen_ardy.data.retarget_rules import RetargetError


def main(arguments: list[str] | None = None) -> int:
    """Run one command. Exit codes: 0 for success, 1 for a set that fails, 2 for input that cannot be used."""
    options = _parser().parse_args(arguments)
    torch.set_num_threads(1)  # clips are small; more threads would only wait for each other
    console = Console()
    try:
        return int(options.run(options, console))
    except (LabelsError, RetargetError, DatasetError, UnknownSkeleton) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.data", description="Make and judge training sets.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    building = commands.add_parser("build", help="turn a folder of BVH files and a labels table into a training set")
    building.add_argument("folder", type=Path, help="folder that the table's file column starts from")
    building.add_argument("labels", type=Path, help="labels table (CSV; docs/data.md lists the columns)")
    building.add_argument("out", type=Path, help="folder to write the set to")
    building.add_argument("--fps", type=_rate, default=20.0, help="frames per second of the set (default 20)")
    building.add_argument("--skeleton", default="core27", help="skeleton of the set (default core27)")
    building.add_argument("--retarget", default="auto", help="a retarget file, or auto to choose by joint names")
    building.add_argument(
        "--skip-flags",
        default="label_suspect,fragment",
        help="leave out clips with these flags, parted by commas (default label_suspect,fragment)",
    )
    building.add_argument("--min-seconds", type=_positive, default=0.5, help="leave out shorter clips (default 0.5)")
    building.add_argument(
        "--standing", action=argparse.BooleanOptionalAction, default=True, help="derive clips of standing from gestures"
    )
    building.add_argument(
        "--derive",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="derive starts, stops, changes, bends, sideways steps, turns on the spot and speeds from walks and runs",
    )
    building.add_argument("--seed", type=_count, default=7, help="of what is drawn at random for --derive (default 7)")
    building.add_argument("--strict", action="store_true", help="end with an error if any file could not be used")
    building.set_defaults(run=_build)

    checking = commands.add_parser("check", help="print the figures of a set and judge them")
    checking.add_argument("set", type=Path)
    checking.set_defaults(run=_check)

    looking = commands.add_parser("look", help="draw a few clips of a set")
    looking.add_argument("set", type=Path)
    looking.add_argument("--png", type=Path, required=True, help="file to write")
    looking.add_argument("--clips", nargs="*", default=[], help="clip ids or contents (default: one of each content)")
    looking.add_argument("--rows", type=_at_least_one, default=12, help="most clips to draw (default 12)")
    looking.set_defaults(run=_look)
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a number above 0, not {text}")
    return value


def _rate(text: str) -> float:
    value = _positive(text)
    if value > MAX_FPS:
        raise argparse.ArgumentTypeError(f"must be {MAX_FPS} at most, as of models, not {text}")
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"must be a whole number from 0 on, not {text}")
    return value


def _at_least_one(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 on, not {text}")
    return value


def _build(options: argparse.Namespace, console: Console) -> int:
    skeleton = load_skeleton(options.skeleton)
    labels = read_labels(options.labels)
    ids, files = {label.id for label in labels}, {file_key(label.file) for label in labels}
    labels += tuple(
        label for label in more_labels(options.folder) if label.id not in ids and file_key(label.file) not in files
    )
    if options.retarget == "auto":
        retargets = tuple(entry for entry in built_in_retargets() if entry.skeleton is skeleton)
        if not retargets:
            raise RetargetError(f"no built-in retarget leads to {skeleton.name}; give a file with --retarget")
    else:
        retargets = (read_retarget(Path(options.retarget)),)
        if retargets[0].skeleton is not skeleton:
            raise RetargetError(f"{options.retarget} leads to {retargets[0].skeleton.name}, not to {skeleton.name}")
    settings = BuildSettings(
        folder=options.folder,
        skeleton=skeleton,
        retargets=retargets,
        fps=options.fps,
        skip_flags=frozenset(filter(None, options.skip_flags.split(","))),
        min_seconds=options.min_seconds,
        derive_standing=options.standing,
        derive_moving=options.derive,
        seed=options.seed,
    )
    prepare_folder(options.out)  # fail before an hour of work if the folder cannot be written to
    with Progress(console=console) as progress:
        task = progress.add_task("converting", total=len(labels))
        result = build(labels, settings, lambda: progress.advance(task))
    for id_, reason in result.skipped:
        console.print(f"skipped {id_}: {reason}", markup=False, highlight=False)
    for reason, count in sorted(result.dropped.items()):
        console.print(f"dropped {count} derived clips of {reason}", markup=False, highlight=False)
    if not result.clips:
        print("error: no clip could be used", file=sys.stderr)
        return 2
    dataset = result.dataset(settings)
    dataset.save(options.out, result.skipped, notes=f"built from {options.labels.name}")
    console.print(_summary(dataset, len(result.skipped)))
    unusable = [
        id_
        for label in labels
        for id_, _ in result.skipped
        if id_ == label.id and not label.flags & settings.skip_flags
    ]
    if options.strict and unusable:
        print(f"error: {len(unusable)} files could not be used (--strict)", file=sys.stderr)
        return 1
    return 0


def _summary(dataset: MotionDataset, num_skipped: int) -> Table:
    table = Table(title=f"{len(dataset.clips)} clips, {num_skipped} left out")
    for column in ("split", "kind", "clips", "frames", "hours"):
        table.add_column(column, justify="left" if column in ("split", "kind") else "right")
    for split in sorted({clip.split for clip in dataset.clips}):
        for kind in ("captured", "derived"):
            clips = [
                clip for clip in dataset.clips if clip.split == split and bool(clip.derived_from) == (kind == "derived")
            ]
            frames = sum(clip.num_frames for clip in clips)
            table.add_row(split, kind, str(len(clips)), str(frames), f"{frames / dataset.fps / 3600:.3f}")
    return table


def _check(options: argparse.Namespace, console: Console) -> int:
    dataset = MotionDataset.load(options.set)
    figures = measure(dataset)
    console.print(figures_table(figures))
    console.print(kinds_table(dataset))
    for id_, reason in skipped_clips(options.set):
        console.print(f"left out {id_}: {reason}", markup=False, highlight=False)
    for line in figures.verdicts:
        console.print(f"{'ok  ' if line.passed else 'FAIL'}  {line.text}", markup=False, highlight=False)
    return 0 if all(line.passed for line in figures.verdicts) else 1


def _look(options: argparse.Namespace, console: Console) -> int:
    from motiongen_ardy.data.look import draw  # matplotlib is only needed to draw

    dataset = MotionDataset.load(options.set)
    drawn = draw(dataset, options.png, options.clips, options.rows)
    console.print(f"drew {drawn} clips to {options.png}", markup=False, highlight=False)
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
