"""The load of an engine, and what admission is told of it."""

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.device_use import DeviceUse
from motiongen_server.engine.scheduling.load_monitor import EVERY_S, LoadMonitor
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.quota_share import QuotaAccount
from motiongen_server.engine.types import Code, Priority, SessionKey
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec

QUOTA_CORES = 1.5


def admitted(gateway: float, told_of_quota: bool) -> int:
    """How many are let in by one of two engines on 1.5 cores, where each session takes a hundredth of a core.

    gateway: cores that it uses. Nobody stands still before the quota is used up.
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


def test_what_others_use_of_a_quota_counts() -> None:
    """65 can be served: twice that hundredth, and a fifth of a core, of 1.5."""
    assert 52 <= admitted(gateway=0.2, told_of_quota=True) <= 60
    assert admitted(gateway=0.2, told_of_quota=False) > 75
