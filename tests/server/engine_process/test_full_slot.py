"""The events that wait for a busy engine are limited."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.types import SessionKey
from motiongen_server.engine_process import slot
from motiongen_server.engine_process.messages import CloseAhead, Events, Load, Stop, Unloaded
from motiongen_server.engine_process.slot import Built
from tests.server.engine_process.audience import close, opening, play
from tests.server.engine_process.test_host import Process, seqs

OTHER = SessionKey(1, 2)


class Open(Process):
    """A process that exposes the inbox from which the engine takes its events."""

    def _build(self, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        if source == "fake":
            self.inbox = inbox
        return super()._build(source, deliver, observe, inbox)


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> Iterator[Open]:
    """One whose engine has more waiting than it may."""
    monkeypatch.setattr(slot, "MOST_WAITING", 2)
    process = Open()
    process.load()
    for seq in (2, 3, 4):
        process.inbox.put(play(seq))
    yield process
    process.tell(Stop())
    ended = process.ended()
    process.end.close()
    process.gateway.close()
    assert ended is None


def let_arrive(process: Open) -> None:
    for _ in range(2):  # by the second answer, everything that had arrived would have been taken
        process.tell(Load(2, "unsound"))
        process.hear_of(Unloaded)


def test_full_inbox_is_given_nothing_but_closes(process: Open) -> None:
    process.tell(Events(1, 1, (opening(),)))
    process.tell(CloseAhead(1, close(9, OTHER), 0, 0))
    let_arrive(process)
    assert seqs(process.engine.wait_for(1)) == [9]
    process.inbox.take_all()
    assert seqs(process.engine.wait_for(2)) == [9, 1]


def test_close_that_overtakes_its_open_while_no_events_are_read_follows_the_open(process: Open) -> None:
    process.tell(Events(1, 1, (opening(), play(2))))
    process.tell(CloseAhead(1, close(9), 1, 2))
    let_arrive(process)
    assert process.engine.taken == []
    process.inbox.take_all()
    assert seqs(process.engine.wait_for(2)) == [1, 9]
    process.tell(Events(1, 3, (opening(OTHER),)))
    assert seqs(process.engine.wait_for(3)) == [1, 9, 1], "the event that it overtook is dropped"
