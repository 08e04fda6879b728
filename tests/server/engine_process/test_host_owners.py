"""What the engines of a process are told of owners: what others did for them, and what they may have now."""

from __future__ import annotations

from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.types import Owner
from motiongen_server.engine_process.messages import Load, OwnerChanged, Ready, StepsElsewhere, Stop, Unload, Unloaded
from motiongen_server.engine_process.slot import Built
from tests.server.engine.fakes import FACTS
from tests.server.engine_process.test_host import Notebook, Process


class Intake:
    """Writes down what an engine is told."""

    def __init__(self) -> None:
        self.notes: list[object] = []
        self.note_owner = self.note_steps_elsewhere = self.notes.append


class Engine(Notebook):
    def __init__(self) -> None:
        super().__init__()
        self.intake = Intake()


class Engines(Process):
    """A process that has an engine for each source."""

    def __init__(self) -> None:
        self.engines = {"first": Engine(), "second": Engine()}
        super().__init__()

    def _build(self, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        return Built(self.engines[source], FACTS, "CC0-1.0")  # type: ignore[arg-type]


def test_engine_is_told_only_of_owners_that_concern_it() -> None:
    process = Engines()
    try:
        for slot, source in enumerate(process.engines, 1):
            process.tell(Load(slot, source))
            process.hear_of(Ready)
        taken, owner = ((Owner("one", steps_per_s=9.0), 4),), Owner("two", weight=3.0)
        process.tell(StepsElsewhere(1, taken))  # those of the first engine
        process.tell(StepsElsewhere(0, ()))  # those of other processes
        process.tell(OwnerChanged(1, owner))
        process.tell(OwnerChanged(3, owner))  # whose model has just been unloaded
        process.tell(Unload(1))
        assert process.hear() == Unloaded(1)
        assert process.engines["first"].intake.notes == [(), owner]
        assert process.engines["second"].intake.notes == [taken, ()]
    finally:
        process.tell(Stop())
        assert process.ended() is None
        process.end.close()
        process.gateway.close()
