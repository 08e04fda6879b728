"""The load of an engine, and what admission is told of it."""

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.device_use import DeviceUse
from motiongen_server.engine.scheduling.levels import FULL
from motiongen_server.engine.scheduling.load_monitor import EVERY_S, LoadMonitor
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.types import Code, Owner, Priority, SessionKey
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import Stage, spec

QUOTA_CORES = 1.5


def admitted(gateway: float, told_of_quota: bool) -> int:
    """How many sessions one of two engines on 1.5 cores admits, where each session takes a hundredth of a core.

    gateway: the cores that it uses. Nothing stalls before the quota is used up.
    """
    used = [0.0]
    account = QuotaAccount(QUOTA_CORES, 2, lambda: used[0], lambda: 0.0)
    device = Device(account if told_of_quota else None)
    admission = Admission(FACTS, EngineConfig(max_sessions=1 << 16, admit_load=(0.9,) * 4))
    monitor = LoadMonitor(FACTS, admission, 0.0, degrade=False, lease=device.lease())
    price = Prices(0.0, 0.01 * FACTS.horizon / FACTS.fps)
    count, now, busy_s = 0, 0.0, 0.0
    while now < 120.0:
        now += EVERY_S
        busy = min(1.0, 0.01 * count)
        busy_s += busy * EVERY_S
        used[0] += min(1.0, (2 * busy + gateway) / QUOTA_CORES) * EVERY_S
        monitor.measure(now, DeviceUse(busy_s, busy_s, busy_s), price, {Priority.NEAR: count})
        key = SessionKey(1, count)
        refusal = admission.reserve(spec(key), 1)
        if refusal is None:
            admission.note_begun(key)
            count += 1
        else:
            assert refusal.code is Code.RESOURCE_EXHAUSTED
    return count


def test_use_of_a_quota_by_other_processes_counts_for_admission() -> None:
    """65 sessions at each engine can be served: with two engines and a fifth of a core, they use up 1.5 cores."""
    assert 52 <= admitted(gateway=0.2, told_of_quota=True) <= 60
    assert admitted(gateway=0.2, told_of_quota=False) > 75


def test_reported_load_is_the_load_that_admission_goes_by() -> None:
    """The quota is half a core, of which other processes use a fifth of a core."""
    time_s, busy_s = [0.0], [0.0]
    lease = Device(QuotaAccount(0.5, 1, lambda: (busy_s[0] + 0.2 * time_s[0]) / 0.5, lambda: busy_s[0])).lease()
    stage = Stage(EngineConfig(admit_load=(0.8,) * 4), lease=lease)

    def step(rows: int) -> float:
        busy_s[0] += 0.01
        time_s[0] = stage.clock.now()
        return 0.01

    stage.runner.step_s = step
    handle = 1
    for _ in range(60):
        for _ in range(4):
            stage.open(handle)
            handle += 1
        stage.run(0.25)
    told = next(report.load for report in reversed(stage.reports) if report.load is not None)
    assert stage.engine.free_share < 0.1, "the engine is full"
    assert told > 0.9 * 0.8
    assert told >= stage.engine.lease.load / 0.5, "its own calls alone take this part of the quota"


class Yielding(Admission):
    """Edits of owners take a sixteenth of the machine beyond their parts."""

    def yielding(self, asks: Owner | None = None) -> float:
        return 0.0625


def test_edits_beyond_their_owners_parts_are_subtracted_in_the_unit_of_load() -> None:
    """An engine uses nearly all of a quota of a quarter of a core; edits take a sixteenth of that, a 64th of a core."""
    lease = Device(QuotaAccount(0.25, 1, lambda: 0.0, lambda: 0.0)).lease()
    admission = Yielding(FACTS, EngineConfig(), under_quota=True)
    monitor = LoadMonitor(FACTS, admission, 0.0, degrade=True, lease=lease)
    prices = Prices(0.0, 0.01 * FACTS.horizon / FACTS.fps)
    for tick in range(1, 41):
        used_s = 0.98 * EVERY_S * tick
        monitor.measure(EVERY_S * tick, DeviceUse(used_s, used_s, used_s), prices, {Priority.CROWD: 50})
    assert monitor.load - 0.0625 < 0.95 < monitor.load - 0.0625 / 4
    assert monitor.level(Priority.CROWD) != FULL


def test_edits_beyond_their_owners_parts_degrade_no_class() -> None:
    """Without a quota: nearly all of a machine is in use, and a sixteenth of it can give way."""
    admission = Yielding(FACTS, EngineConfig())
    monitor = LoadMonitor(FACTS, admission, 0.0, degrade=True, lease=Device().lease())
    for tick in range(1, 41):
        used_s = 0.98 * EVERY_S * tick
        monitor.measure(EVERY_S * tick, DeviceUse(used_s, used_s, used_s), Prices(0.0, 1e-6), {Priority.CROWD: 50})
    assert monitor.load > 0.95 > monitor.load - 0.0625
    assert monitor.level(Priority.CROWD) == FULL
