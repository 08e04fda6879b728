"""Settings of a training (how long, how fast, where to), and their command-line flags."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch


@dataclass(frozen=True)
class LoopSettings:
    """How long, how fast and where to train. minutes: stop after so many minutes of this call; 0: never."""

    out: Path
    steps: int
    learning_rate: float
    warmup_steps: int = 500
    minutes: float = 0.0
    save_minutes: float = 5.0
    ema_decay: float = 0.999
    clip_norm: float = 1.0
    bfloat16: bool = True
    seed: int = 0
    log_every: int = 100


def add_loop_arguments(parser: argparse.ArgumentParser, steps: int, learning_rate: float, batch: int) -> None:
    """Add the flags that every training command has."""
    parser.add_argument("data", type=Path, help="training set made by `python -m motiongen_ardy.data build`")
    parser.add_argument("out", type=Path, help="run folder: state to resume from, logs, exported weights")
    parser.add_argument("--steps", type=_whole(1), default=steps, help="length of the schedule (default %(default)s)")
    parser.add_argument(
        "--batch", type=_whole(1), default=batch, help="windows per step and process (default %(default)s)"
    )
    parser.add_argument(
        "--lr", type=_above_zero, default=learning_rate, help="peak learning rate (default %(default)s)"
    )
    parser.add_argument("--warmup", type=_whole(0), default=500, help="steps of warm-up (default %(default)s)")
    parser.add_argument("--minutes", type=_from_zero, default=0.0, help="stop, saved, after so many minutes; 0 = never")
    parser.add_argument(
        "--save-minutes", type=_from_zero, default=5.0, help="minutes between saves (default %(default)s)"
    )
    parser.add_argument("--float32", action="store_true", help="no bfloat16 mixed precision")
    parser.add_argument("--seed", type=_whole(0), default=0, help="seed of weights, windows and noise")
    parser.add_argument(
        "--device",
        type=_device,
        default="cuda" if torch.cuda.is_available() else "cpu",
        help="cpu or cuda (default: cuda where there is a GPU)",
    )


def _whole(least: int) -> Callable[[str], int]:
    """A parser of whole numbers that are at least `least`."""

    def read(text: str) -> int:
        if not text.strip().lstrip("+-").isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of {least} or more")
        return int(text)

    return read


def _from_zero(text: str) -> float:
    value = _finite(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is below 0")
    return value


def _above_zero(text: str) -> float:
    value = _finite(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is no finite number")
    return value


def _device(text: str) -> str:
    """A device that exists; with torchrun, one for each of its processes."""
    try:
        device = torch.device(text)
    except RuntimeError:
        device = None
    if device is None or device.type not in ("cpu", "cuda"):
        raise argparse.ArgumentTypeError(f"{text!r} is no device for training; give cpu or cuda")
    if device.type == "cpu":
        return text
    number = int(os.environ.get("LOCAL_RANK", "0")) if device.index is None else device.index
    there = torch.cuda.device_count()
    if number >= there:
        raise argparse.ArgumentTypeError(
            f"{text!r}: there are {there} GPUs that torch can use, and this would need {number + 1}; give cpu, or"
            " --nproc-per-node with as many processes as there are GPUs"
        )
    return text


def loop_settings(arguments: argparse.Namespace) -> LoopSettings:
    """The settings from parsed flags of `add_loop_arguments`."""
    return LoopSettings(
        out=arguments.out,
        steps=arguments.steps,
        learning_rate=arguments.lr,
        warmup_steps=arguments.warmup,
        minutes=arguments.minutes,
        save_minutes=arguments.save_minutes,
        bfloat16=not arguments.float32,
        seed=arguments.seed,
    )
