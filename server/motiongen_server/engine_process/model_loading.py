"""Loads what an engine process holds: a model on its device with its engine, and a text encoder that needs torch."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from motiongen_server.config import ServerConfig
from motiongen_server.devices import ADMIT_LOAD
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.own_time import own_time_s
from motiongen_server.engine.ports import Deliver, Inbox, Observe, Runner
from motiongen_server.engine.scheduling.device import Device, InTurns
from motiongen_server.engine.scheduling.profile import profile
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.scheduling.trial_jobs import usual_passes
from motiongen_server.engine.scheduling.warm_up import warm_up
from motiongen_server.engine.types import ModelFacts
from motiongen_server.engine_process.host import FreeUnused, LoadText, TextEncoder
from motiongen_server.engine_process.messages import Begin
from motiongen_server.engine_process.slot import BuildEngine, Built
from motiongen_server.models.repertoire import as_abilities
from motiongen_server.processor_quota import quota_cores, quota_use
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities
from motiongen_server.settings import SettingError

if TYPE_CHECKING:  # torch takes seconds
    from motiongen_server.runner import TorchRunner

log = logging.getLogger(__name__)


class MonotonicClock:
    """The engine's clock."""

    def now(self) -> float:
        return time.monotonic()


class ProcessorClock:
    """Runs only while the process has CPU time: calls are measured with it where a quota throttles the process."""

    def __init__(self, quota: QuotaAccount) -> None:
        self._quota = quota

    def now(self) -> float:
        return self._quota.spent_s()


@dataclass(frozen=True)
class RunnerOfModel:
    """A model on its device, the weights' licence, and what it was trained for."""

    runner: TorchRunner
    licence: str
    abilities: Abilities = NOTHING_CLAIMED


def prepare(begin: Begin) -> tuple[BuildEngine, LoadText, FreeUnused]:
    """The loaders of an engine process, and what frees its kernels. Its models take turns on its device."""
    device = device_of(begin)

    def build(source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        model = load_model(begin.config, source, begin.kind, begin.threads)
        config = replace(begin.config, model=source)
        check_fit(config, model.runner.facts)
        with model.runner.recording_at_once():  # also while measuring, since sessions will replay graphs
            if begin.kind == "cuda" and config.cuda_graphs:
                config = replace(config, max_rows=record_graphs(config, model.runner, device))
            engine = build_engine(config, model.runner, deliver, observe, inbox, device)
        return Built(engine, model.runner.facts, model.licence, model.abilities, model.runner.weights)

    def load_text(width: int) -> TextEncoder:
        from motiongen_ardy.text import load_text_encoder

        config = begin.config
        try:
            return load_text_encoder(config.text_encoder, width, config.text_device, config.text_precision)
        except (ValueError, RuntimeError, OSError) as error:
            raise SettingError(f"cannot serve text encoder {config.text_encoder!r}: {error}") from error

    def free_unused() -> None:
        from motiongen_server.runner.kernels import free_kernels

        free_kernels()

    return build, load_text, free_unused


def device_of(begin: Begin) -> Device:
    """The device on which the engines of this process compute."""
    if begin.kind == "cpu":
        return Device(quota_account(begin.engines, begin.threads))
    return Device(counts_own=True)


def quota_account(engines: int, threads: int) -> QuotaAccount | None:
    """The account of the CPU quota of this process's control group, shared by that many engines with that many threads.

    None if there is no quota, or the system does not report its use.
    """
    used_s = quota_use()
    if used_s is None:
        return None
    return QuotaAccount(quota_cores() / threads, engines, used_s, lambda: time.process_time() / threads)


def import_libraries() -> None:
    """Import what `prepare` and its loaders import when they are called, so that forked processes need not."""
    # Threads that spin while they wait for each other make every product several times slower as soon as another
    # process wants a core. OpenMP reads this once, when torch is loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import torch

    import motiongen_ardy.capabilities
    import motiongen_ardy.checkpoint.model_card
    import motiongen_server.runner.kernels

    del torch, motiongen_ardy, motiongen_server


def load_model(config: ServerConfig, source: str, kind: str = "cpu", threads: int = 1) -> RunnerOfModel:
    """A model on a device of that kind. Raises SettingError that says what is wrong with the settings."""
    import_libraries()
    import torch

    from motiongen_ardy.capabilities import read_capabilities
    from motiongen_ardy.checkpoint.model_card import model_folder, read_model_card
    from motiongen_server.runner import load_runner

    if kind == "cuda" and not torch.cuda.is_available():
        raise SettingError("devices has cuda, but torch finds no such CUDA device and driver here; use cpu:1")
    torch.set_num_threads(threads)
    try:
        runner = load_runner(source, kind, config.denoise_steps, config.precision, config.cuda_graphs)
        folder = model_folder(source)
        card = read_model_card(folder)
        abilities = as_abilities(read_capabilities(folder))
        check_domain(abilities, runner.facts)
    except (ValueError, RuntimeError, OSError) as error:
        raise SettingError(f"cannot serve model {source!r}: {error}") from error
    return RunnerOfModel(runner, card.licence, abilities)


def check_domain(abilities: Abilities, facts: ModelFacts) -> None:
    """Raise SettingError if prompts could not be compared with those that the model was trained with."""
    domain = abilities.domain
    if domain is not None and len(domain.mean) != facts.embedding_dim:
        raise SettingError(
            f"the prompt domain of {facts.model_id} has vectors of {len(domain.mean)} numbers, but the model takes "
            f"{facts.embedding_dim}; remove prompt_domain.safetensors, or make it again"
        )


def record_graphs(config: ServerConfig, runner: Runner, device: Device) -> int:
    """Record graphs of the usual batches now, so that sessions do not wait for that later. Returns the most windows
    that a step may have: `max_rows` of the setting, or fewer if there is no memory for more beside the graphs.

    Other models at work wait for single calls only.
    """
    from motiongen_ardy.model.packed.graphs import sizes_up_to

    begun_at, lease, passes = time.monotonic(), device.lease(), usual_passes(runner)
    most, largest = 0, config.max_rows
    try:
        while largest and most != largest:  # out of memory, all graphs are freed: try again with fewer windows
            most = largest
            sizes, history_frames = sizes_up_to(most, passes), runner.facts.whole_patches(config.history_frames)
            largest = warm_up(InTurns(runner, lease), sizes, history_frames)
    finally:
        lease.leave()
    log.info("recorded graphs of up to %d windows in %.1f s", largest, time.monotonic() - begun_at)
    if 0 < largest < config.max_rows:
        log.warning("the device has no memory for graphs of more than %d windows: no step has more", largest)
    return largest or config.max_rows


def check_fit(config: ServerConfig, facts: ModelFacts) -> None:
    """Raise SettingError if the settings ask for what the model cannot do."""
    if not facts.min_steps <= config.denoise_steps <= facts.max_steps:
        raise SettingError(
            f"denoise_steps is {config.denoise_steps}; {facts.model_id} takes {facts.min_steps} to {facts.max_steps}"
        )
    for name, given in (
        ("lookahead_frames", config.lookahead_for(facts.horizon)),
        ("max_lookahead_frames", config.max_lookahead_frames),
    ):
        if given < facts.horizon:
            raise SettingError(f"{name} is {given}; {facts.model_id} needs at least {facts.horizon}")
    if facts.whole_patches(config.history_frames) > facts.max_history:
        raise SettingError(
            f"history_frames is {config.history_frames}; {facts.model_id} takes at most {facts.max_history}"
        )


def build_engine(
    config: ServerConfig,
    runner: Runner,
    deliver: Deliver,
    observe: Observe,
    inbox: Inbox | None = None,
    device: Device | None = None,
) -> Engine:
    """Check that the settings fit, measure the model, and make the engine. Raises SettingError if they do not fit.

    device: other engines may be at work on it; they wait only for single calls while the model is measured.
    """
    check_fit(config, runner.facts)
    clock, history_frames = MonotonicClock(), runner.facts.whole_patches(config.history_frames)
    lease = (device or Device()).lease()
    try:
        stopwatch = clock if lease.quota is None else ProcessorClock(lease.quota)
        measured = profile(runner, stopwatch, config.max_rows, history_frames, config.profile_s, lease)
        engine_config = EngineConfig(
            max_sessions=config.max_sessions,
            max_rows=measured.max_rows,
            max_step_s=config.max_step_ms / 1000,
            history_crop=history_frames,
            flush_s=config.flush_ms / 1000,
            idle_timeout_s=config.idle_timeout_s,
            rewind_s=config.rewind_s,
            playback_rate=config.playback_rate,
            admit_load=admit_loads(config.admit_load),
            degrade=config.degrade,
            trace_as=f"pid {os.getpid()}" if config.trace_to else "",
            snapshots=config.snapshot_store not in ("", "none") and config.resume_grace_s > 0,
        )
        if lease.counts_own:
            measured.costs.begin_own(own_time_s(runner.facts, engine_config))
        scheduler = Scheduler(
            measured.costs,
            measured.max_rows,
            max_step_s=engine_config.max_step_s,
            under_quota=lease.quota is not None,
        )
        return Engine(
            runner,
            clock,
            deliver,
            engine_config,
            observe=observe,
            inbox=inbox,
            scheduler=scheduler,
            lease=lease,
        )
    except ValueError as error:
        lease.leave()
        raise SettingError(str(error)) from error
    except Exception:
        lease.leave()
        raise


def admit_loads(load: float | None) -> tuple[float, float, float, float]:
    """The load up to which each class is admitted: heroes a little beyond `load`, to leave them room, others below."""
    load = ADMIT_LOAD if load is None else load
    hero, near, crowd, batch = 1.02, 1.0, 0.98, 0.85
    return hero * load, near * load, crowd * load, batch * load
