"""The events that wait for a busy engine are limited."""

from __future__ import annotations

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


def test_full_inbox_is_given_nothing_but_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slot, "MOST_WAITING", 2)
    process = Open()
    try:
        process.load()
        for seq in (2, 3, 4):
            process.inbox.put(play(seq))
        process.tell(Events(1, 1, (opening(),)))
        process.tell(CloseAhead(1, close(9, OTHER), 0, 0))
        for _ in range(2):  # by the second answer, everything that had arrived would have been taken
            process.tell(Load(2, "unsound"))
            process.hear_of(Unloaded)
        assert seqs(process.engine.wait_for(1)) == [9]
        process.inbox.take_all()
        assert seqs(process.engine.wait_for(2)) == [9, 1]
    finally:
        process.tell(Stop())
        assert process.ended() is None
        process.end.close()
        process.gateway.close()
