"""The training loop of both parts: mixed precision, EMA, resuming, progress, TensorBoard, one or many processes.

On a CUDA device, each batch shape is captured once as a graph, including drawing the batch and updating the weights,
and then replayed: these networks are so small that launching their kernels one by one would take most of the time.
"""

from __future__ import annotations

import contextlib
import copy
import signal
import time
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import numpy as np
import torch
import torch.distributed
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.nn.parallel import DistributedDataParallel
from torch.optim.lr_scheduler import LambdaLR
from torch.utils.tensorboard import SummaryWriter

from motiongen_ardy.train.loop_settings import LoopSettings
from motiongen_ardy.train.moving_average import MovingAverage
from motiongen_ardy.train.optimizer import AdamAtan2, warmup_cosine
from motiongen_ardy.train.run_folder import check_goes_on, loading, read_state, write_state, writing

UNFINISHED = 3
WARM_UP_UPDATES = 3
AVERAGE_EVERY = 5
STOP_EVERY = 10
"""Steps between agreements, among processes that train together, on whether to stop."""


Batch = Any


class Diverged(FloatingPointError):
    """Raised if a loss or the gradient is not finite; what was saved before is kept."""


class Task(Protocol):
    """What is trained. `module(batch)` returns the total loss and its named parts.

    fingerprint: identifies what the module is trained on and does not change; "" if there is nothing.
    terms: other conditions, by name, that a resumed run must share with its beginning.
    """

    module: nn.Module
    fingerprint: str
    terms: Mapping[str, str]

    def kinds(self, progress: float) -> Sequence[tuple[Hashable, float]]:
        """The kinds of batches, each of one shape, with their chances, at a share 0..1 of the training."""

    def sample(self, kind: Hashable, generator: torch.Generator | None) -> Batch:
        """A random batch of a kind, on the module's device. generator: None: the device's own random numbers."""

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write the current result, with the averaged weights, into `folder`."""


@contextlib.contextmanager
def _answered(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Within this context, `handler` receives SIGTERM and Ctrl-C."""
    previous = {number: signal.signal(number, handler) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


class Trainer:
    """Runs a task to its last step, its time limit or a SIGTERM, and can resume from any of these."""

    def __init__(self, task: Task, settings: LoopSettings, rank: int = 0, num_processes: int = 1) -> None:
        self.task = task
        self.settings = settings
        self.rank = rank
        self.device = next(task.module.parameters()).device
        trained = [parameter for parameter in task.module.parameters() if parameter.requires_grad]
        self.captures = self.device.type == "cuda" and num_processes == 1
        rate = torch.tensor(settings.learning_rate, device=self.device) if self.captures else settings.learning_rate
        self.optimizer = AdamAtan2(trained, rate)
        self.schedule = LambdaLR(self.optimizer, warmup_cosine(settings.warmup_steps, settings.steps))
        self.schedule.base_lrs = [settings.learning_rate]
        self.averaged = MovingAverage(task.module, settings.ema_decay)
        self.forward: nn.Module = task.module
        if num_processes > 1:
            # A tokenizer has tensors that are never used (`target_cond_blocks`), which must not be waited for.
            self.forward = DistributedDataParallel(task.module, find_unused_parameters=True)
        self.seed = settings.seed * num_processes + rank
        self.generator = torch.Generator(self.device)
        self.choices = np.random.default_rng(self.seed)
        self.graphs: dict[Hashable, tuple[torch.cuda.CUDAGraph, dict[str, Tensor]]] = {}
        self.step = 0
        self.stopping = False
        self._seed()
        self._resume()

    def _seed(self) -> None:
        """Seed the random numbers by the current step: a resumed run does not repeat those that it began with."""
        seed = self.seed + 7919 * self.step
        torch.manual_seed(seed)
        self.generator.manual_seed(seed)
        self.choices = np.random.default_rng(seed)

    def _resume(self) -> None:
        folder = self.settings.out
        state = read_state(folder)
        if state is None:
            return
        check_goes_on(folder, state, self.task.fingerprint, self.task.terms)
        with loading(folder):
            self.task.module.load_state_dict(state["module"])
            self.averaged.load_state_dict(state["averaged"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step = int(state["step"])
        # The schedule is a function of the step alone, so another --steps or --lr applies from here on.
        rate = self.settings.learning_rate
        for group in self.optimizer.param_groups:
            group["initial_lr"] = rate
            group["lr"] = torch.tensor(rate, device=self.device) if self.captures else rate
            if "step" in group:  # missing in a run that was stopped before its first update
                group["step"] = group["step"].to(self.device)
        self.schedule.last_epoch = self.step
        self._seed()

    def save(self) -> None:
        """Write the state to resume from (atomically) and export the averaged weights. Raises RunFolderError."""
        if self.rank:
            return
        state = {
            "module": self.task.module.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "fingerprint": self.task.fingerprint,
            "terms": dict(self.task.terms),
        }
        with writing(self.settings.out):
            self.settings.out.mkdir(parents=True, exist_ok=True)
            write_state(self.settings.out, state)
            self.task.export(copy.deepcopy(self.averaged.module).eval(), self.settings.out)

    @property
    def exit_code(self) -> int:
        """For the command line: not 0 if steps are left, so that nothing is built on an unfinished training."""
        return UNFINISHED if self.step < self.settings.steps else 0

    def train_step(self) -> dict[str, Tensor]:
        """One batch, one update. Returns the named losses, which the next step may overwrite."""
        self.task.module.train()
        kinds = self.task.kinds(self.step / max(1, self.settings.steps))
        chances = np.array([chance for _, chance in kinds])
        kind = kinds[int(self.choices.choice(len(kinds), p=chances / chances.sum()))][0]
        losses = self._replay(kind) if self.captures else self._update(kind, self.generator)
        self.schedule.step()
        self.step += 1
        return losses

    def _update(self, kind: Hashable, generator: torch.Generator | None) -> dict[str, Tensor]:
        """Draw a batch, and update the weights and their average."""
        batch = self.task.sample(kind, generator)
        self.optimizer.zero_grad(set_to_none=True)
        with contextlib.ExitStack() as stack:
            if self.device.type == "cpu":
                # On a CPU, the fused kernel's backward pass takes three times as long as plain matrix products.
                stack.enter_context(sdpa_kernel(SDPBackend.MATH))
            # A captured step must cast the weights again at every replay, so casts must not be cached.
            mixed = torch.autocast(
                self.device.type, torch.bfloat16, enabled=self.settings.bfloat16, cache_enabled=not self.captures
            )
            with mixed:
                total, parts = self.forward(batch)
            total.backward()
        norm = nn.utils.clip_grad_norm_(self.task.module.parameters(), self.settings.clip_norm)
        self.optimizer.step()
        if self.captures:
            self.averaged.update(self.task.module)
        elif self.step % AVERAGE_EVERY == 0:  # touches all weights, which on a CPU costs as much as a small batch
            self.averaged.update(self.task.module, AVERAGE_EVERY)
        return {"total": total.detach(), "gradient": norm.detach()} | parts

    def _replay(self, kind: Hashable) -> dict[str, Tensor]:
        """As `_update`, replayed from a graph that is captured once per kind. A kind's first updates are warm-ups."""
        if kind in self.graphs:
            graph, losses = self.graphs[kind]
            graph.replay()
            return losses
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(WARM_UP_UPDATES):
                losses = self._update(kind, None)
        torch.cuda.current_stream().wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        self.optimizer.zero_grad(set_to_none=True)
        with torch.cuda.graph(graph):
            captured = self._update(kind, None)
        self.graphs[kind] = graph, captured
        return losses

    def check_finite(self, losses: dict[str, Tensor]) -> None:
        """Raise Diverged if a loss or the gradient is not finite."""
        wrong = {name: float(value) for name, value in losses.items() if not bool(torch.isfinite(value))}
        if wrong:
            raise self._diverged(f"these are not finite: {wrong}")

    def check_sound(self, losses: dict[str, Tensor]) -> None:
        """Before a save: raise Diverged if losses or weights are not finite, instead of overwriting good ones."""
        self.check_finite(losses)
        if not all(bool(weights.isfinite().all()) for weights in self.task.module.parameters()):
            raise self._diverged("weights are not finite")

    def _diverged(self, what: str) -> Diverged:
        return Diverged(
            f"step {self.step}: {what}; what was saved before is kept: go on from there with a lower --lr than"
            f" {self.settings.learning_rate:g}, or with --float32"
        )

    def run(self) -> None:
        """Train until done; saves every few minutes and at the end, also after SIGTERM and Ctrl-C.

        A second Ctrl-C ends a single process at once, unsaved. Raises Diverged, and RunFolderError if it cannot save.
        """
        with _answered(self._ask_to_stop):
            self.check_sound(self._train())
            self.save()
            if torch.distributed.is_initialized():
                torch.distributed.barrier()  # from here on, what the first process has written is complete

    def _train(self) -> dict[str, Tensor]:
        """Train until done or asked to stop. Returns the losses of the last step; empty if no step was left."""
        settings = self.settings
        losses: dict[str, Tensor] = {}
        started = saved = time.monotonic()
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with (
            writing(settings.out),
            contextlib.nullcontext() if self.rank else SummaryWriter(str(settings.out / "log")) as writer,
            Progress(*columns, TimeRemainingColumn(), disable=self.rank != 0) as progress,
        ):
            bar = progress.add_task("training", total=settings.steps, completed=self.step)
            running: dict[str, Tensor] = {}
            is_over = False
            while self.step < settings.steps and not is_over:
                losses = self.train_step()
                for name, value in losses.items():
                    running[name] = value.clone() if name not in running else running[name].lerp(value, 0.02)
                now = time.monotonic()
                if self.step % settings.log_every == 0:
                    self.check_finite(losses)
                    if writer is not None:
                        self._log(writer, running)
                        text = " ".join(f"{name} {float(value):.4f}" for name, value in running.items())
                        progress.update(bar, completed=self.step, description=text)
                if now - saved > 60 * settings.save_minutes:
                    self.check_sound(losses)
                    self.save()
                    saved = now
                is_over = self.stops(started)
        return losses

    def stops(self, started: float) -> bool:
        """Whether to stop after this step: time limit reached since `started`, or asked to.

        Processes that train together stop at the same step, whichever of them has to: one that stopped alone would
        leave the others waiting for its gradients.
        """
        self.stopping |= 0 < 60 * self.settings.minutes < time.monotonic() - started
        if not torch.distributed.is_initialized():
            return self.stopping
        if self.step % STOP_EVERY:
            return False
        anyone = torch.tensor(float(self.stopping), device=self.device)
        torch.distributed.all_reduce(anyone, torch.distributed.ReduceOp.MAX)
        self.stopping = bool(anyone)
        return self.stopping

    def _log(self, writer: SummaryWriter, running: dict[str, Tensor]) -> None:
        for name, value in running.items():
            writer.add_scalar(f"loss/{name}", float(value), self.step)
        writer.add_scalar("learning_rate", self.schedule.get_last_lr()[0], self.step)

    def _ask_to_stop(self, number: int, _frame: FrameType | None) -> None:
        """Stop after a step, not within one: its update would be incomplete, and other processes would wait for it."""
        self.stopping = True
        if number == signal.SIGINT and not torch.distributed.is_initialized():  # torchrun sends each one twice
            signal.signal(number, signal.default_int_handler)
