import threading
from collections.abc import Callable

import pytest

from motiongen_server.engine.mailbox import Mailbox
from motiongen_server.engine.types import Close, Event, Open, Playhead, SessionKey, SetPrompts
from tests.server.engine.stage import spec
from tests.waiting import until

ONE, TWO = SessionKey(1, 1), SessionKey(1, 2)


def _edit(seq: int, key: SessionKey = ONE) -> SetPrompts:
    return SetPrompts(key, seq, 0.0)


def _playhead(frame: int, key: SessionKey = ONE) -> Playhead:
    return Playhead(key, 0, 0.0, frame, frame, 0)


def test_events_are_taken_in_the_order_of_their_arrival() -> None:
    mailbox = Mailbox(8)
    events: list[Event] = [_edit(1), _edit(1, TWO), _edit(2), Close(TWO, 2, 0.0)]
    assert all(mailbox.put(event) for event in events)
    assert mailbox.take_all() == events
    assert mailbox.take_all() == []


def test_newer_playhead_replaces_an_older_one_of_the_same_session() -> None:
    mailbox = Mailbox(8)
    events: list[Event] = [_playhead(1), _edit(1), _playhead(1, TWO), _playhead(2), _playhead(3)]
    for event in events:
        mailbox.put(event)
    assert mailbox.take_all() == [events[4], events[1], events[2]]
    mailbox.put(_playhead(4))
    assert mailbox.take_all() == [_playhead(4)]


def test_edits_beyond_the_limit_are_refused_and_a_close_is_always_taken() -> None:
    mailbox = Mailbox(2)
    assert [mailbox.put(_edit(seq)) for seq in (1, 2, 3)] == [True, True, False]
    assert mailbox.put(_edit(1, TWO))
    assert mailbox.put(_playhead(1))
    assert mailbox.put(Close(ONE, 4, 0.0))
    assert len(mailbox.take_all()) == 5
    assert mailbox.put(_edit(3))


def test_playhead_of_a_new_session_stays_behind_its_open() -> None:
    mailbox = Mailbox(8)
    events: list[Event] = [_playhead(30), Close(ONE, 2, 0.0), Open(spec(ONE), 1, 0.0), _playhead(0)]
    for event in events:
        mailbox.put(event)
    assert mailbox.take_all() == events


class _Notified(threading.Condition):
    """Counts its notifications."""

    count = 0

    def notify(self, n: int = 1) -> None:
        self.count += 1
        super().notify(n)


def _sleeper(mailbox: Mailbox) -> threading.Thread:
    """A thread that waits without a limit, and ends afterwards."""
    thread = threading.Thread(target=mailbox.wait, args=(threading.TIMEOUT_MAX,), daemon=True)
    thread.start()
    return thread


def _sleeps(mailbox: Mailbox, thread: threading.Thread) -> bool:
    """Whether the thread, once it has looked, still waits."""
    until(lambda: mailbox._asleep or not thread.is_alive())
    return thread.is_alive()


@pytest.mark.parametrize("wake", [lambda mailbox: mailbox.put(_edit(1)), Mailbox.ring], ids=["event", "ring"])
def test_event_or_ring_ends_a_wait_once_and_the_next_wait_before_it_sleeps(wake: Callable[[Mailbox], object]) -> None:
    mailbox = Mailbox(8)
    mailbox._arrived = notified = _Notified(mailbox._lock)
    first = _sleeper(mailbox)
    assert _sleeps(mailbox, first), "nothing has come"
    wake(mailbox)
    assert notified.count == 1
    assert not _sleeps(mailbox, first)
    assert not _sleeps(mailbox, _sleeper(mailbox)), "what came has not been taken"
    mailbox.take_all()
    assert _sleeps(mailbox, third := _sleeper(mailbox))
    mailbox.ring()
    assert not _sleeps(mailbox, third)


def test_events_that_come_while_nobody_sleeps_notify_nobody() -> None:
    mailbox = Mailbox(8)
    mailbox._arrived = notified = _Notified(mailbox._lock)
    assert _sleeps(mailbox, thread := _sleeper(mailbox))
    for seq in range(1, 4):
        mailbox.put(_edit(seq))
    assert not _sleeps(mailbox, thread)
    mailbox.put(_edit(4))
    assert notified.count == 1


def test_no_event_is_lost_or_reordered_between_threads() -> None:
    mailbox = Mailbox(10_000)

    def write(handle: int) -> None:
        for seq in range(500):
            mailbox.put(_edit(seq, SessionKey(2, handle)))

    threads = [threading.Thread(target=write, args=(handle,)) for handle in range(4)]
    taken: list[Event] = []
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        mailbox.wait(0.01)
        taken += mailbox.take_all()
    taken += mailbox.take_all()
    for n in range(4):
        assert [event.event_seq for event in taken if event.session.handle == n] == list(range(500))


def test_lower_playhead_does_not_replace_a_higher_one() -> None:
    box = Mailbox(4)
    key = SessionKey(1, 1)
    for frame in (20, 3):
        box.put(Playhead(key, 0, 0.0, frame, 40, 0))
    (held,) = box.take_all()
    assert isinstance(held, Playhead)
    assert held.frame == 20
