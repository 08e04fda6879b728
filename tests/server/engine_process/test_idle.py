"""An idle engine process frees the memory that it keeps for further windows."""

from __future__ import annotations

import threading

import pytest

from motiongen_server.engine_process import host
from motiongen_server.engine_process.messages import Stop
from motiongen_server.ops.memory import FreedMemory
from tests.server.engine_process.test_host import Process
from tests.waiting import LIMIT_S


class Looks(FreedMemory):
    """Counts how often the process checked whether to free memory."""

    looked = threading.Semaphore(0)

    def is_due(self, *, is_busy: bool) -> bool:
        due = super().is_due(is_busy=is_busy)
        self.looked.release()
        return due


def test_memory_kept_for_windows_is_freed_once_no_session_is_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "FreedMemory", Looks)
    monkeypatch.setattr(host, "FREED_EVERY_S", 0.01)
    process = Process()
    process.engine.num_sessions = 1
    process.load()
    for _ in range(3):
        assert Looks.looked.acquire(timeout=LIMIT_S)
    assert not process.freed.is_set()
    process.engine.num_sessions = 0
    assert process.freed.wait(LIMIT_S)
    process.tell(Stop())
    assert process.ended() is None
    process.end.close()
    process.gateway.close()
