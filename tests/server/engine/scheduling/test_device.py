"""The device that engines of one process share: they take turns, and each admits only what the others leave."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.device import BACKGROUND_SHARE, Device, DeviceLease, InTurns
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.profile import profile
from motiongen_server.engine.scheduling.window_rates import EXPECTED_HZ
from motiongen_server.engine.types import Code, Open, Priority, SessionKey
from tests.server.engine.engine_thread import EngineThread
from tests.server.engine.fakes import FACTS, FakeClock, FakeRunner
from tests.server.engine.stage import spec
from tests.waiting import LIMIT_S


class CountedDevice(Device):
    """Counts the turns that were taken, and those that were ended."""

    num_taken = num_ended = 0

    def take(self) -> float:
        waited_s = super().take()
        self.num_taken += 1
        return waited_s

    def pass_on(self) -> None:
        self.num_ended += 1
        super().pass_on()


def test_turns_are_given_in_the_order_they_were_asked_for() -> None:
    device, order = Device(), list[int]()
    device.take()
    threads = []
    for number in range(5):

        def turn(number: int = number) -> None:
            with device.lease():
                order.append(number)

        thread = threading.Thread(target=turn)
        thread.start()
        while device.num_waiting <= number:
            thread.join(0.001)
        threads.append(thread)
    device.pass_on()
    for thread in threads:
        thread.join(LIMIT_S)
    assert order == [0, 1, 2, 3, 4]


def test_lease_that_asks_again_at_once_queues_behind_waiting_ones() -> None:
    device, order = Device(), list[str]()
    busy, other = device.lease(), device.lease()

    def wait_once() -> None:
        with other:
            order.append("other")

    with busy:
        thread = threading.Thread(target=wait_once)
        thread.start()
        while not device.num_waiting:
            thread.join(0.001)
    with busy:
        order.append("busy again")
    thread.join(LIMIT_S)
    assert order == ["other", "busy again"]
    assert other.waited_s > 0


def test_error_during_a_turn_ends_the_turn() -> None:
    lease = Device().lease()
    with pytest.raises(RuntimeError), lease:
        raise RuntimeError("in a step")
    with lease:
        pass


def test_lease_knows_the_load_of_the_others_until_they_leave() -> None:
    device = Device()
    leases = [device.lease() for _ in range(3)]
    for lease, load in zip(leases, (0.2, 0.3, 0.1), strict=True):
        lease.load = load
    assert leases[0].elsewhere == pytest.approx(0.4)
    assert leases[0].stretch == pytest.approx(1 / 0.6)
    leases[1].leave()
    assert (leases[0].elsewhere, device.load) == (pytest.approx(0.1), pytest.approx(0.3))
    leases[2].leave()
    assert (leases[0].elsewhere, leases[0].stretch) == (0.0, 1.0)


def test_stretch_is_at_most_the_number_of_engines_on_the_device() -> None:
    device = Device()
    mine, other = device.lease(), device.lease()
    other.load = 3.0
    assert mine.stretch == 2.0


def turn(lease: DeviceLease, seconds: float, background: float = 0.0) -> None:
    with lease:
        lease.note_call(seconds, background)


def test_background_gets_a_share_of_others_turns_and_repays_what_it_overdraws() -> None:
    device = Device()
    clips, sessions = device.lease(), device.lease()
    clips.num_background = 8
    turn(clips, 0.05, background=1.0)
    assert clips.spare_s == math.inf, "no session waits for a window"
    sessions.num_waited_for = 1
    assert clips.spare_s == 0.0
    turn(sessions, 0.02)
    assert clips.spare_s == pytest.approx(BACKGROUND_SHARE * 0.02)
    turn(sessions, 0.02)
    assert clips.spare_s == pytest.approx(BACKGROUND_SHARE * 0.02), "what was not used is not saved up"
    turn(clips, 0.01, background=1.0)
    turn(sessions, 0.02)
    assert clips.spare_s == 0.0
    turn(sessions, 0.02)
    assert clips.spare_s == pytest.approx(3 * BACKGROUND_SHARE * 0.02 - 0.01)
    assert sessions.stretch == pytest.approx(1.0 + BACKGROUND_SHARE)
    sessions.leave()
    assert clips.spare_s == math.inf


@pytest.mark.parametrize("elsewhere", [0.45, 0.95])
def test_load_of_other_engines_reduces_what_is_admitted(elsewhere: float) -> None:
    admission = Admission(FACTS, EngineConfig(admit_load=(0.9, 0.9, 0.9, 0.9)))
    rate_hz = FACTS.fps / FACTS.horizon + EXPECTED_HZ[Priority.NEAR]
    admission.set_prices(Prices(step_s=0.0, window_s=0.1 / rate_hz), 0.0, elsewhere)  # 0.1 a session
    taken = 0
    while (refusal := admission.reserve(spec(SessionKey(1, taken)), 1)) is None:
        admission.note_begun(SessionKey(1, taken))
        taken += 1
    assert refusal.code is Code.RESOURCE_EXHAUSTED
    assert taken == (4 if elsewhere == 0.45 else 0)


def test_engine_steps_only_in_its_turns_and_leaves_the_device_at_its_end() -> None:
    device, opened = Device(), threading.Event()
    runner = FakeRunner(FakeClock())
    engine = Engine(runner, runner.clock, lambda _: opened.set(), EngineConfig(), lease=device.lease())
    with device.lease():
        thread = EngineThread(engine)
        assert engine.submit(Open(spec(SessionKey(1, 1)), 1, runner.clock.now())) is None
        while not device.num_waiting:
            assert not thread.join(0.001)
        assert not opened.is_set()
    assert opened.wait(LIMIT_S)
    engine.stop()
    assert thread.join(LIMIT_S)
    assert device.num_seats == 1  # the test's own


@pytest.mark.parametrize("by_runner", [True, False])
def test_profiling_beside_engines_takes_one_turn_for_each_call(by_runner: bool) -> None:
    device, under_way, calls = CountedDevice(), list[int](), list[tuple[str, int]]()

    def note(call: str, _: Sequence[int]) -> bool:
        under_way.append(device.num_taken - device.num_ended)
        calls.append((call, device.num_taken))
        return False

    runner = FakeRunner(FakeClock(), fails=note)
    lease = device.lease()
    measured = InTurns(runner, lease) if by_runner else runner
    profile(measured, runner.clock, max_rows=1, history_frames=16, turn=None if by_runner else lease)
    assert set(under_way) == {1}
    assert {call for call, _ in calls} == {"prepare", "denoise", "decode"}
    assert len({turn for _, turn in calls}) == len(calls), "two calls in one turn"
    assert device.num_taken == device.num_ended
    assert (measured.facts, runner.jobs) == (FACTS, {})


def test_background_owes_at_most_a_second_and_nothing_once_no_session_waits() -> None:
    device = Device()
    clips, sessions = device.lease(), device.lease()
    sessions.num_waited_for = 1
    with clips:
        clips.note_call(30.0, 1.0)  # the call stalled
    for _ in range(60):
        with sessions:
            sessions.note_call(0.1, 0.0)
    with clips:
        assert clips.spare_s > 0.0
        clips.note_call(30.0, 1.0)
    sessions.num_waited_for = 0
    with clips:
        clips.note_call(0.1, 1.0)
    sessions.num_waited_for = 1
    with sessions:
        sessions.note_call(0.1, 0.0)
    with clips:
        assert clips.spare_s > 0.0
