"""The failure of an engine is reported at once, whatever else its process is doing."""

from __future__ import annotations

import threading

from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine_process.messages import Ended, Load
from motiongen_server.engine_process.slot import Built
from motiongen_server.settings import SettingError
from tests.server.engine_process.test_host import Notebook, Process
from tests.waiting import LIMIT_S


class Breaking(Notebook):
    """An engine that fails as soon as it is woken."""

    def wait(self) -> None:
        self.stopped.wait()
        raise ZeroDivisionError("in the loop")

    def end_failed(self) -> None:
        """It holds no sessions."""

    @property
    def finished(self) -> bool:
        return False


class Loading(Process):
    """Holds a model whose engine will fail, and loads another until the test lets that end."""

    def __init__(self) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()
        super().__init__()
        self.engine = Breaking()

    def _build(self, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        if source == "large":
            self.begun.set()
            assert self.go_on.wait(LIMIT_S)
            raise SettingError("the device is gone")
        return super()._build(source, deliver, observe, inbox)


def test_failure_of_an_engine_is_reported_while_another_model_is_loading() -> None:
    process = Loading()
    try:
        process.load()
        process.tell(Load(2, "large"))
        assert process.begun.wait(LIMIT_S)
        process.engine.stop()
        assert process.hear_of(Ended) == Ended("ZeroDivisionError: in the loop")
    finally:
        process.go_on.set()
        assert isinstance(process.ended(), ZeroDivisionError)
        process.end.close()
        process.gateway.close()
