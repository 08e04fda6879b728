"""The last message of an engine is sent before its process closes its sockets."""

from __future__ import annotations

import threading

import pytest

from motiongen_server.engine_process.messages import Stop, ToGateway, Unloaded
from motiongen_server.engine_process.outlet import Wire
from motiongen_server.engine_process.slot import Slot
from tests.server.engine_process.test_host import Notebook, Process
from tests.waiting import LIMIT_S


def test_ending_process_waits_for_the_last_message_of_its_engine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speaks, is_waited_for = threading.Event(), threading.Event()
    said: list[ToGateway] = []
    say, join = Wire.say, Slot.join

    def say_late(wire: Wire, message: ToGateway) -> None:
        if isinstance(message, Unloaded):
            speaks.set()
            assert is_waited_for.wait(LIMIT_S)
            said.append(message)
        say(wire, message)

    def wait_for(slot: Slot) -> None:
        is_waited_for.set()
        join(slot)

    class Quick(Notebook):
        """An engine that has ended before `stop` returns."""

        def stop(self) -> None:
            super().stop()
            assert speaks.wait(LIMIT_S)

    monkeypatch.setattr(Wire, "say", say_late)
    monkeypatch.setattr(Slot, "join", wait_for)
    process = Process()
    process.engine = Quick()
    process.load()
    process.tell(Stop())
    try:
        assert process.ended() is None
        assert said == [Unloaded(1)]
    finally:
        is_waited_for.set()
        process.end.close()
        process.gateway.close()
