"""Loading in an engine process: its quota of processor time, measured costs, recorded graphs, wrong settings."""

from __future__ import annotations

import math
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.model.packed.graphs import sizes_up_to
from motiongen_ardy.text.domain import DOMAIN_FILE, make_domain, write_domain
from motiongen_server.config import parse_config
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.mailbox import Mailbox
from motiongen_server.engine.ports import OutOfMemory
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import Priority, ServiceTier, WindowJob
from motiongen_server.engine_process import model_loading
from motiongen_server.engine_process.messages import Begin
from motiongen_server.engine_process.model_loading import (
    RunnerOfModel,
    admit_loads,
    build_engine,
    device_of,
    load_model,
    prepare,
    quota_account,
    record_graphs,
)
from motiongen_server.settings import SettingError
from tests.ardy.broken_checkpoints import TINY
from tests.server.engine.fakes import FakeClock, FakeRunner
from tests.server.engine.stage import Stage


def account_of(
    monkeypatch: pytest.MonkeyPatch, threads: int, cores: float, spent_s: Callable[[], float]
) -> QuotaAccount:
    """The account of one engine under a quota that nobody else uses. spent_s: processor time of its process."""
    monkeypatch.setattr(model_loading, "quota_cores", lambda: cores)
    monkeypatch.setattr(model_loading, "quota_use", lambda: lambda: spent_s() / cores)
    monkeypatch.setattr(model_loading.time, "process_time", spent_s)
    account = quota_account(1, threads)
    assert account is not None
    return account


def test_quota_account_counts_per_thread_of_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    account = account_of(monkeypatch, 4, 6.0, lambda: 12.0)
    assert (account.cores, account.spent_s(), account.used_s()) == (1.5, 3.0, 2.0)


def test_there_is_no_quota_account_without_a_measured_use(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_loading, "quota_use", lambda: None)
    monkeypatch.setattr(model_loading, "quota_cores", lambda: math.inf)
    assert quota_account(1, 4) is None


@pytest.mark.parametrize("threads", [1, 4])
def test_engine_under_a_quota_serves_all_admitted_sessions_in_full(
    monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    """It has as many cores as threads, and keeps all of them busy for two thirds of the time."""
    busy_s = 0.0

    def step_s(rows: int) -> float:
        return 0.004 + 0.001 * rows

    def step(rows: int) -> float:
        nonlocal busy_s
        busy_s += step_s(rows)
        return step_s(rows)

    account = account_of(monkeypatch, threads, float(threads), lambda: threads * busy_s)
    costs = CostTable.assumed(0.0)
    for rows in (1, 2, 4, 8, 16, 32, 64):
        costs.step.begin(rows, step_s(rows))
    scheduler = Scheduler(costs, 64, max_step_s=0.035, under_quota=True)
    stage = Stage(EngineConfig(admit_load=admit_loads(0.9)), scheduler=scheduler, lease=Device(account).lease())
    stage.runner.step_s = step
    for handle in range(1, 161):
        stage.open(handle, priority=Priority.CROWD)
    tiers = Counter[ServiceTier]()
    for _ in range(60):
        stage.run(0.25)
        tiers[stage.tiers()[Priority.CROWD]] += 1
    assert busy_s > 0.5 * 15.0
    assert stage.engine.num_sessions > 120
    assert set(tiers) == {ServiceTier.FULL}


class BusyDevice(Device):
    """A device on which another engine takes a step of 30 ms before each turn."""

    def __init__(self, quota: QuotaAccount, clock: FakeClock) -> None:
        super().__init__(quota)
        self._clock = clock

    def take(self) -> float:
        waited_s = super().take()
        self._clock.advance(0.03)
        return waited_s


def test_waits_for_another_engine_are_not_measured_as_costs() -> None:
    runner = FakeRunner(FakeClock())
    runner.step_s = lambda rows: 0.001 + 0.0003 * rows
    account = QuotaAccount(1.0, 1, runner.clock.now, runner.clock.now)
    config = parse_config(["--max-rows", "8"])
    engine = build_engine(
        config, runner, lambda outputs: None, lambda report: None, None, BusyDevice(account, runner.clock)
    )
    assert engine.windows.prices().step_s == pytest.approx(0.0003 + 0.001 / 8, rel=0.01)
    assert engine.windows.prices().window_s == pytest.approx(0.0, abs=1e-6)


def test_only_on_a_gpu_the_engine_s_own_time_is_in_the_first_window_price(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(model_loading, "own_time_s", lambda facts, config: 1e6)
    windows_s = []
    for kind in ("cpu", "cuda"):
        device = device_of(Begin(parse_config([]), kind=kind, threads=1, engines=1))
        engine = build_engine(
            parse_config([]), FakeRunner(FakeClock()), lambda outputs: None, lambda report: None, None, device
        )
        windows_s.append(engine.windows.prices().window_s)
    on_processor_s, beside_gpu_s = windows_s
    assert on_processor_s < 1e6 <= beside_gpu_s


class ShortOfMemory(FakeRunner):
    """Has memory for `most` windows, and keeps the sizes that it recorded; it drops them all when memory runs out."""

    def __init__(self, most: int) -> None:
        super().__init__(FakeClock())
        self.most, self.kept = most, set[tuple[int, int]]()

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        if len(jobs) > self.most:
            self.kept.clear()
            raise OutOfMemory("no room")
        self.kept.add((len(jobs), len(jobs[0].history)))
        super().prepare(jobs)


@pytest.mark.parametrize(("most", "rows"), [(12, 12), (0, 32), (100, 32)])
def test_graphs_dropped_for_lack_of_memory_are_recorded_again(
    most: int, rows: int, caplog: pytest.LogCaptureFixture
) -> None:
    runner, device = ShortOfMemory(most), Device()
    assert record_graphs(parse_config(["--max-rows", "32"], {}), runner, device) == rows
    sizes = [size for size in sizes_up_to(rows) if size <= most]
    assert {(size, frames) for size in sizes for frames in (0, 16)} <= runner.kept
    assert ("of more than 12 windows" in caplog.text) is (most == 12)
    assert device.num_seats == 0


def test_setting_that_does_not_fit_the_model_is_refused_before_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    class Recording(FakeRunner):
        def recording_at_once(self) -> AbstractContextManager[None]:
            raise AssertionError("nothing is to be recorded")

    loaded = RunnerOfModel(Recording(FakeClock()), "CC0-1.0")  # type: ignore[arg-type]
    monkeypatch.setattr(model_loading, "load_model", lambda *given: loaded)
    build, *_ = prepare(Begin(parse_config(["--history-frames", "400"], {}), "cuda", 1, 1))
    with pytest.raises(SettingError, match="history_frames is 400"):
        build("fake", lambda outputs: None, lambda report: None, Mailbox(8))


def test_prompt_domain_of_another_width_than_the_model_is_a_setting_error(tmp_path: Path) -> None:
    """Otherwise every prompt would fail when it is compared."""
    folder = shutil.copytree(TINY, tmp_path / "tiny")
    write_domain(folder / DOMAIN_FILE, make_domain("hashed-7", np.eye(7, dtype=np.float32), 4))
    (folder / "capabilities.yaml").write_text("knows: [walking]")
    with pytest.raises(SettingError, match=rf"'{folder}'.*vectors of 7 numbers, but the model takes 32"):
        load_model(parse_config([], {}), str(folder))
    write_domain(folder / DOMAIN_FILE, make_domain("hashed-32", np.eye(32, dtype=np.float32), 4))
    assert load_model(parse_config([], {}), str(folder)).abilities.known_motions == ("walking",)


def test_folder_that_cannot_be_read_is_a_setting_error() -> None:
    with pytest.raises(SettingError, match=r"cannot serve model 'aaa.*File name too long"):
        load_model(parse_config([], {}), "a" * 300)
