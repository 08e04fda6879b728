"""Evaluate a model's motion: `python -m motiongen_ardy.evaluate MODEL DATA`; exit code 1 if a bound is missed.

Exit code 2 if nothing could be judged: a model, a set, an encoder or a setting that cannot be used.
Windows are made as the server makes them: 16 frames of history, the model's own guidance and corrections.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from rich.console import Console

from motiongen_ardy.capabilities import LocomotionPreset, parse_capabilities, read_capabilities
from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.files import CheckpointError, read_yaml
from motiongen_ardy.checkpoint.hub import HubError
from motiongen_ardy.checkpoint.model_card import UnknownModel, model_folder
from motiongen_ardy.checkpoint.sampling_file import read_options
from motiongen_ardy.core.output import command
from motiongen_ardy.data.dataset import DatasetError, MotionDataset
from motiongen_ardy.evaluate.cases import captured_figures, load_cases
from motiongen_ardy.evaluate.context import QUICK, Context, Size
from motiongen_ardy.evaluate.judge import FOLDER, JudgeMissing, TextJudge, load_judge
from motiongen_ardy.evaluate.report import Report
from motiongen_ardy.evaluate.rows.table import FAMILIES
from motiongen_ardy.evaluate.sampler import MotionNotFinite, Sampler, Sampling
from motiongen_ardy.evaluate.take_files import write_takes
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.model import Model
from motiongen_ardy.text import (
    TextEncoder,
    TextEncoderUnavailable,
    TextWidthMismatch,
    UnknownTextEncoder,
    load_text_encoder,
)
from motiongen_ardy.train.feature_bank import natural_layout

UNUSABLE = (
    UnknownModel, HubError, DatasetError, ConfigError, CheckpointError,
    UnknownTextEncoder, TextWidthMismatch, TextEncoderUnavailable, JudgeMissing, MotionNotFinite,
)  # fmt: skip


def main() -> None:
    """Command line."""
    arguments = _arguments()
    console = Console(stderr=True)
    torch.set_num_threads(arguments.threads)
    try:
        subject = _subject(arguments)
        _prepare(arguments)
        reports = []
        for steps in arguments.steps:
            report = _judge(subject, steps, arguments, console)
            if arguments.json is not None:
                report.write(_of_steps(arguments.json, report, len(arguments.steps)))
            reports.append(report)
    except (*UNUSABLE, OSError) as error:
        print(f"python -m motiongen_ardy.evaluate: {error}", file=sys.stderr)
        sys.exit(2)
    for report in reports:
        Console(width=190).print(report.table())
        if report.unjudged:
            print(f"no takes to judge these by: {'; '.join(report.unjudged)}", file=sys.stderr)
    if not any(figure.status for report in reports for figure in report.figures):
        print("python -m motiongen_ardy.evaluate: no bound could be judged", file=sys.stderr)
        sys.exit(2)
    sys.exit(1 if any(report.missed for report in reports) else 0)


def _prepare(arguments: argparse.Namespace) -> None:
    """Create the output folders, so that hours of evaluation do not end with figures that cannot be written.

    Raises OSError, which names the file or folder.
    """
    folders = [arguments.png, arguments.takes, None if arguments.json is None else arguments.json.parent]
    for folder in folders:
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
    if arguments.json is not None and arguments.json.is_dir():
        raise IsADirectoryError(f"{arguments.json} is a folder; --json names a file")


@dataclass(frozen=True, eq=False)
class Subject:
    """What is evaluated, and with which clips."""

    model: Model
    gaits: Sequence[LocomotionPreset]
    encoder: TextEncoder
    dataset: MotionDataset
    judge: TextJudge | None


def _subject(arguments: argparse.Namespace) -> Subject:
    """Everything that the command line names, loaded. Raises one of UNUSABLE."""
    folder = model_folder(arguments.model)
    model, abilities = load_checkpoint(folder), read_capabilities(folder)
    if arguments.capabilities is not None:
        abilities = parse_capabilities(read_yaml(arguments.capabilities), str(arguments.capabilities))
    if arguments.sampling is not None:
        model.sampling = read_options(read_yaml(arguments.sampling), model.config.guidance)
    for steps in arguments.steps:
        if not 1 <= steps <= model.config.num_base_steps:
            raise ConfigError(f"--steps has {steps}; this model takes 1 to {model.config.num_base_steps}")
    dataset = MotionDataset.load(arguments.data, arguments.split)
    dataset.require(model.config.skeleton, model.config.fps)
    encoder = load_text_encoder(arguments.text_encoder, model.config.denoiser.text_dim)
    return Subject(model, abilities.locomotion, encoder, dataset, _text_judge(model, encoder, arguments))


def _text_judge(model: Model, encoder: TextEncoder, arguments: argparse.Namespace) -> TextJudge | None:
    """The judge of text and motion; without it, its rows are left out. Raises JudgeMissing if they were asked for."""
    if arguments.rows is not None and "matching" not in arguments.rows:
        return None
    try:
        return load_judge(model.representation, encoder.width, arguments.judge, encoder.identity)
    except JudgeMissing as error:
        if arguments.rows is not None:
            raise
        print(f"without the rows of matching: {error}", file=sys.stderr)
        return None


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.evaluate", description=__doc__)
    parser.add_argument("model", help="built-in model's name or a checkpoint folder")
    parser.add_argument("data", type=Path, help="data set made by `python -m motiongen_ardy.data build`")
    parser.add_argument("--split", default="test", choices=("test", "validation"), help="default %(default)s")
    parser.add_argument("--steps", type=_numbers, default=(4,), help="denoising steps, as 4 or 4,10 (default 4)")
    parser.add_argument("--rows", type=_families, help=f"of {','.join(FAMILIES)}; default all that can be judged")
    parser.add_argument("--judge", type=Path, default=FOLDER, help="folder of a judge of text and motion, for matching")
    parser.add_argument(
        "--seeds", type=_at_least_one, default=Size.seeds, help="takes of each clip (default %(default)s)"
    )
    parser.add_argument("--quick", action="store_true", help="few clips, one seed, one-minute sessions")
    parser.add_argument(
        "--raw", action="store_true", help="without projection of the root and clean-up; its own bounds"
    )
    parser.add_argument("--sampling", type=Path, help="a sampling.yaml in place of the model's own")
    parser.add_argument("--capabilities", type=Path, help="a capabilities.yaml in place of the model's own")
    parser.add_argument("--text-guidance", type=_weight, help="the model's own if absent")
    parser.add_argument("--constraint-guidance", type=_weight, help="the model's own if absent")
    parser.add_argument("--text-encoder", default="static")
    parser.add_argument("--json", type=Path, help="write the figures here; with several step counts one file each")
    parser.add_argument("--png", type=Path, help="folder to draw a sheet of each part into")
    parser.add_argument("--takes", type=Path, help="folder to write a few takes of each part into, for a gallery")
    parser.add_argument("--threads", type=_at_least_one, default=1, help="cores (default %(default)s)")
    return parser.parse_args()


def _weight(text: str) -> float:
    try:
        weight = float(text)
    except ValueError:
        weight = math.nan
    if not math.isfinite(weight):
        raise argparse.ArgumentTypeError(f"{text!r} is no weight; give a finite number")
    return weight


def _at_least_one(text: str) -> int:
    if not text.strip().isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of 1 or more")
    return int(text)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(","))


def _families(text: str) -> tuple[str, ...]:
    names = tuple(text.split(","))
    unknown = [name for name in names if name not in FAMILIES]
    if unknown:
        raise argparse.ArgumentTypeError(f"no rows {', '.join(unknown)}; there are {', '.join(FAMILIES)}")
    return names


def _of_steps(path: Path, report: Report, num_reports: int) -> Path:
    return path if num_reports == 1 else path.with_stem(f"{path.stem}-{report.about['steps']}")


def _weights(model: Model, arguments: argparse.Namespace) -> GuidanceWeights:
    own = model.sampling.guidance
    text, constraint = arguments.text_guidance, arguments.constraint_guidance
    return GuidanceWeights(own.text if text is None else text, own.constraint if constraint is None else constraint)


def uncorrected(model: Model) -> None:
    """Switch off the corrections that bring a model's motion onto its goals and hold its feet in place."""
    model.sampling = replace(model.sampling, project_root=False, clean_feet=False, reach_joints=False)


def _judge(
    subject: Subject,
    steps: int,
    arguments: argparse.Namespace,
    console: Console,
) -> Report:
    model, dataset = subject.model, subject.dataset
    if arguments.raw:
        uncorrected(model)
    weights = _weights(model, arguments)
    sampler = Sampler(model, subject.encoder, Sampling(steps, weights), subject.gaits)
    layout = natural_layout(dataset.skeleton, model.config.fps)
    cases = load_cases(dataset, layout)
    size = QUICK if arguments.quick else replace(Size(), seeds=arguments.seeds)
    context = Context(sampler, cases, captured_figures(cases, layout), size, arguments.raw, subject.judge)
    began = time.monotonic()
    for name in arguments.rows or [name for name in FAMILIES if name != "matching" or subject.judge is not None]:
        start = time.monotonic()
        FAMILIES[name](context)
        console.print(f"{name}: {time.monotonic() - start:.0f} s, {sampler.num_windows} windows so far")
        if arguments.takes is not None:
            write_takes(context.exhibits, context.layout, arguments.takes, steps)
        if arguments.png is not None:
            _draw(context, arguments.png, steps)
        context.exhibits.clear()
    captured = context.captured
    about = {
        "model": arguments.model,
        "data": arguments.data.name,
        "split": arguments.split,
        "steps": steps,
        "guidance": f"{model.sampling.guidance.mode} {weights.text:g} / {weights.constraint:g}",
        "corrections": "none" if arguments.raw else "as served",
        "captures": f"feet {captured.walking.feet:.2f}, running {captured.running.feet:.2f}; accelerations"
        f" {captured.walking.acceleration:.0f}, running {captured.running.acceleration:.0f} m/s2",
        "windows": sampler.num_windows,
        "seconds": round(time.monotonic() - began),
    }
    return Report(about, context.figures, context.unjudged)


def _draw(context: Context, folder: Path, steps: int) -> None:
    from motiongen_ardy.evaluate.sheets import draw_sheet  # matplotlib takes a second to import

    for family, exhibits in context.exhibits.items():
        draw_sheet(exhibits, context.layout, folder / f"{family}-{steps}.png")


if __name__ == "__main__":
    sys.exit(command(main))
