"""How long, how fast and where to a part is trained, and the flags that say so."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.distributed


@dataclass(frozen=True)
class LoopSettings:
    """How long, how fast and where to. minutes: stop after so much time in this call, 0 = never."""

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
    parser.add_argument("--steps", type=int, default=steps, help="length of the schedule (default %(default)s)")
    parser.add_argument("--batch", type=int, default=batch, help="windows a step and process (default %(default)s)")
    parser.add_argument("--lr", type=float, default=learning_rate, help="peak learning rate (default %(default)s)")
    parser.add_argument("--warmup", type=int, default=500, help="steps of rising rate (default %(default)s)")
    parser.add_argument("--minutes", type=float, default=0.0, help="stop, saved, after so many minutes; 0 = never")
    parser.add_argument("--save-minutes", type=float, default=5.0, help="minutes between saves (default %(default)s)")
    parser.add_argument("--float32", action="store_true", help="no bfloat16 mixed precision")
    parser.add_argument("--seed", type=int, default=0, help="seed of weights, windows and noise")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")


def loop_settings(arguments: argparse.Namespace) -> LoopSettings:
    """The settings that parsed flags of `add_loop_arguments` ask for."""
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
