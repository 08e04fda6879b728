"""The training loop both parts share: mixed precision, EMA, resuming, progress, TensorBoard, one or many processes."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import copy
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
import torch.distributed
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.nn.parallel import DistributedDataParallel
from torch.optim.lr_scheduler import LambdaLR
from torch.optim.swa_utils import AveragedModel
from torch.utils.tensorboard import SummaryWriter

from motiongen_ardy.train.optimizer import AdamAtan2, warmup_cosine

STATE_FILE = "state.pt"
Batch = Any


class Task(Protocol):
    """What is trained. `module(batch)` gives the total loss and its named parts."""

    module: nn.Module

    def sample(self, generator: torch.Generator) -> Batch:
        """A random batch, on the module's device."""

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write what training has reached, from the averaged weights, into `folder`."""


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
    log_every: int = 50


def add_loop_arguments(parser: argparse.ArgumentParser, steps: int, learning_rate: float, batch: int) -> None:
    """Add the flags that every training command has."""
    parser.add_argument("data", type=Path, help="training set made by `python -m motiongen_ardy.data build`")
    parser.add_argument("out", type=Path, help="run folder: state to resume from, logs, exported weights")
    parser.add_argument("--steps", type=int, default=steps, help="length of the schedule (default %(default)s)")
    parser.add_argument("--batch", type=int, default=batch, help="windows a step and process (default %(default)s)")
    parser.add_argument("--lr", type=float, default=learning_rate, help="peak learning rate (default %(default)s)")
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
        minutes=arguments.minutes,
        save_minutes=arguments.save_minutes,
        bfloat16=not arguments.float32,
        seed=arguments.seed,
    )


def moving_average(decay: float) -> Callable[[list[Tensor], list[Tensor], Tensor | int], None]:
    """Exponential moving average of parameters whose memory grows from nothing to 1 / (1 - decay) updates.

    With a constant decay, the untrained weights would still weigh in after thousands of steps.
    """

    @torch.no_grad()
    def update(averaged: list[Tensor], current: list[Tensor], num_averaged: Tensor | int) -> None:
        count = int(num_averaged)
        torch._foreach_lerp_(averaged, current, 1 - min(decay, (1 + count) / (10 + count)))

    return update


@contextlib.contextmanager
def distributed() -> Iterator[tuple[int, int]]:
    """(rank, number of processes); joins the process group when started by torchrun.

    One group serves all trainings of a process, and is left at its end: a second one would find the first one's
    addresses in torchrun's store, and wait for them for ever.
    """
    if "RANK" not in os.environ:
        yield 0, 1
        return
    if not torch.distributed.is_initialized():
        torch.distributed.init_process_group("nccl" if torch.cuda.is_available() else "gloo")
        atexit.register(torch.distributed.destroy_process_group)
        if torch.cuda.is_available():
            torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    yield torch.distributed.get_rank(), torch.distributed.get_world_size()


class Trainer:
    """Runs a task to its last step, to its time limit or to a SIGTERM, and can go on from any of these."""

    def __init__(self, task: Task, settings: LoopSettings, rank: int = 0, num_processes: int = 1) -> None:
        self.task = task
        self.settings = settings
        self.rank = rank
        self.device = next(task.module.parameters()).device
        trained = [parameter for parameter in task.module.parameters() if parameter.requires_grad]
        self.optimizer = AdamAtan2(trained, settings.learning_rate)
        self.schedule = LambdaLR(self.optimizer, warmup_cosine(settings.warmup_steps, settings.steps))
        self.averaged = AveragedModel(task.module, multi_avg_fn=moving_average(settings.ema_decay))
        self.forward: nn.Module = task.module
        if num_processes > 1:
            # A tokenizer carries tensors that take no part (`target_cond_blocks`), which must not be waited for.
            self.forward = DistributedDataParallel(task.module, find_unused_parameters=True)
        self.generator = torch.Generator().manual_seed(settings.seed * num_processes + rank)
        self.step = 0
        self.stopping = False
        self._resume()

    def _resume(self) -> None:
        path = self.settings.out / STATE_FILE
        if not path.exists():
            return
        state = torch.load(path, map_location="cpu", weights_only=True)
        self.task.module.load_state_dict(state["module"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step = state["step"]
        # The schedule is a function of the step alone, so a longer --steps or another --lr holds from here on.
        for group in self.optimizer.param_groups:
            group["initial_lr"] = self.settings.learning_rate
        self.schedule.base_lrs = [self.settings.learning_rate]
        self.schedule.last_epoch = self.step
        self.generator.manual_seed(self.settings.seed + 7919 * self.step + self.rank)

    def save(self) -> None:
        """Write the state to resume from (atomically) and export the averaged weights."""
        if self.rank:
            return
        self.settings.out.mkdir(parents=True, exist_ok=True)
        state = {
            "module": self.task.module.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
        }
        partial = self.settings.out / (STATE_FILE + ".partial")
        torch.save(state, partial)
        partial.replace(self.settings.out / STATE_FILE)
        self.task.export(copy.deepcopy(self.averaged.module).eval(), self.settings.out)

    def train_step(self) -> dict[str, Tensor]:
        """One batch, one update. Returns the named losses; raises FloatingPointError when the loss is not finite."""
        self.task.module.train()
        batch = self.task.sample(self.generator)
        self.optimizer.zero_grad(set_to_none=True)
        with contextlib.ExitStack() as stack:
            if self.device.type == "cpu":
                # The fused kernel's backward pass on a CPU takes three times as long as plain matrix products.
                stack.enter_context(sdpa_kernel(SDPBackend.MATH))
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self.settings.bfloat16):
                total, parts = self.forward(batch)
            total.backward()
        norm = nn.utils.clip_grad_norm_(self.task.module.parameters(), self.settings.clip_norm)
        if not torch.isfinite(norm):
            raise FloatingPointError(f"step {self.step}: the gradient is not finite; losses are {parts}")
        self.optimizer.step()
        self.schedule.step()
        self.averaged.update_parameters(self.task.module)
        self.step += 1
        return {"total": total.detach(), "gradient": norm.detach()} | parts

    def run(self) -> None:
        """Train until done; saves every few minutes and at the end, also after SIGTERM and Ctrl-C."""
        settings = self.settings
        started = saved = time.monotonic()
        previous = signal.signal(signal.SIGTERM, self._ask_to_stop)
        writer = SummaryWriter(str(settings.out / "log")) if self.rank == 0 else None
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        try:
            with Progress(*columns, TimeRemainingColumn(), disable=self.rank != 0) as progress:
                bar = progress.add_task("training", total=settings.steps, completed=self.step)
                running: dict[str, Tensor] = {}
                while self.step < settings.steps and not self.stopping:
                    for name, value in self.train_step().items():
                        running[name] = value if name not in running else running[name].lerp(value, 0.02)
                    now = time.monotonic()
                    if self.step % settings.log_every == 0 and writer is not None:
                        self._log(writer, running)
                        text = " ".join(f"{name} {float(value):.4f}" for name, value in running.items())
                        progress.update(bar, completed=self.step, description=text)
                    if now - saved > 60 * settings.save_minutes:
                        self.save()
                        saved = now
                    self.stopping |= 0 < 60 * settings.minutes < now - started
        except KeyboardInterrupt:
            self.stopping = True
        finally:
            signal.signal(signal.SIGTERM, previous)
            if writer is not None:
                writer.close()
        self.save()
        if torch.distributed.is_initialized():
            torch.distributed.barrier()  # whoever returns may rely on what the first process has written

    def _log(self, writer: SummaryWriter, running: dict[str, Tensor]) -> None:
        for name, value in running.items():
            writer.add_scalar(f"loss/{name}", float(value), self.step)
        writer.add_scalar("learning_rate", self.schedule.get_last_lr()[0], self.step)

    def _ask_to_stop(self, _signal: int, _frame: object) -> None:
        self.stopping = True
