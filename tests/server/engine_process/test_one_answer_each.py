"""However client, gateway and engine are interleaved, each event with a number is answered once."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from motiongen_server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    Event,
    Open,
    Opened,
    Outcome,
    Output,
    Playhead,
    SessionKey,
)
from motiongen_server.engine_process.arrivals import Arrivals
from motiongen_server.engine_process.messages import CloseAhead, Events, Ready
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from tests.server.engine.fakes import FACTS
from tests.server.engine_process.audience import close, opening, play, playhead

READY = Ready(1, FACTS, "CC0-1.0", NOTHING_CLAIMED)


class LittleEngine:
    """Admits, refuses and ends sessions at random; its outputs wait in `said`."""

    def __init__(self, chance: random.Random) -> None:
        self._chance = chance
        self._arrivals = Arrivals()
        self._inbox: list[Event] = []
        self.open: set[SessionKey] = set()
        self.said: list[list[Output]] = []

    def take(self, message: Events | CloseAhead) -> None:
        is_close = isinstance(message, CloseAhead)
        for event in self._arrivals.ahead(message) if is_close else self._arrivals.in_order(message):  # type: ignore[arg-type]
            if isinstance(event, Open) and self._chance.random() < 0.4:  # at once, ahead of waiting events
                self.said.append([Outcome(event.session, event.event_seq, Code.RESOURCE_EXHAUSTED)])
            else:
                self._inbox.append(event)

    def step(self) -> None:
        said = [answer for event in self._inbox if (answer := self._answer(event)) is not None]
        self._inbox.clear()
        for key in sorted(self.open):
            if self._chance.random() < 0.05:
                self.open.remove(key)
                said.append(Closed(key, CloseReason.IDLE, Code.OK, "", 0, 0))
        if said:
            self.said.append(said)

    def _answer(self, event: Event) -> Output | None:
        key = event.session
        if isinstance(event, Open):
            assert key not in self.open
            self.open.add(key)
            return Opened(key, 1, 0, 40, 5, 4, "tiny", "stick", 20)
        if isinstance(event, Playhead):
            return None
        if key not in self.open:
            return Outcome(key, event.event_seq, Code.NOT_FOUND)
        if isinstance(event, Close):
            self.open.remove(key)
            return Closed(key, event.reason, Code.OK, "", 0, 0)
        return Outcome(key, event.event_seq, Code.OK)


@dataclass
class Told:
    """What a client has sent for one session. waiting: numbers of events without an answer, except its Close."""

    waiting: set[int] = field(default_factory=lambda: {1})
    last: int = 1
    close_seq: int = 0
    is_open: bool = False


class Client:
    """Opens sessions with one key one after the other, each as soon as it has heard of the end of the one before."""

    def __init__(self, key: SessionKey) -> None:
        self.key = key
        self.now: Told | None = None
        self.refused = Told(set())

    def says(self, chance: random.Random) -> Event | None:
        if self.now is None:
            self.now = Told()
            return opening(self.key)
        if self.now.close_seq:
            return None
        wish = chance.choice(["edit", "edit", "playhead", "close"])
        if wish == "playhead":
            return playhead(3, self.key)
        self.now.last += 1
        if wish == "close":
            self.now.close_seq = self.now.last
            return close(self.now.last, self.key)
        self.now.waiting.add(self.now.last)
        return play(self.now.last, self.key)

    def hear(self, said: Output) -> None:
        if isinstance(said, Outcome) and self.now is None:  # an answer besides the refusal of its Open
            self.refused.waiting.remove(said.event_seq)
        elif isinstance(said, Outcome) and self.now is not None:
            self.now.waiting.remove(said.event_seq)
            if said.event_seq == 1:
                self.refused, self.now = self.now, None
                if self.refused.close_seq:
                    self.refused.waiting.add(self.refused.close_seq)
            else:
                assert not (self.now.is_open and said.code is Code.NOT_FOUND), "the answer was for another session"
        elif isinstance(said, Opened) and self.now is not None:
            self.now.is_open = True
            self.now.waiting.remove(1)
        else:
            assert isinstance(said, Closed)
            assert self.now is not None
            assert self.now.is_open
            assert not self.now.waiting
            self.now = None

    def check(self) -> None:
        assert not self.refused.waiting
        if self.now is not None:
            assert (self.now.waiting, self.now.close_seq, self.now.is_open) == (set(), 0, True)


class Play:
    """One gateway, one engine, and two clients. A close never arrives after events that were sent later."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.clients = {key: Client(key) for key in (SessionKey(1, 1), SessionKey(1, 2))}
        self.link = ModelLink(1, "model", self.deliver, lambda: None)
        self.link.take_ready(READY)
        self.engine = LittleEngine(self.chance)
        self.under_way: list[Events | CloseAhead] = []

    def deliver(self, outputs: Sequence[Output]) -> None:
        for said in outputs:
            self.clients[said.session].hear(said)

    def submit(self) -> None:
        event = self.chance.choice([*self.clients.values()]).says(self.chance)
        if event is not None:
            assert self.link.submit(event) is None

    def send(self) -> None:
        events = self.link.take_events()
        self.under_way += [] if events is None else [events]
        self.under_way += self.link.take_closes()

    def arrive(self) -> None:
        closes = [message for message in self.under_way if isinstance(message, CloseAhead)]
        if closes and self.chance.random() < 0.5:
            self.under_way.remove(closes[0])
            self.engine.take(closes[0])
        elif self.under_way:
            self.engine.take(self.under_way.pop(0))

    def hear(self) -> None:
        if self.engine.said:
            self.link.take_outputs(self.engine.said.pop(0))

    def lose(self) -> None:
        """Now and then, the engine is lost with everything in transit, and another takes its place."""
        if self.chance.random() < 0.1:
            self.link.lose(CloseReason.ENGINE_FAULT, "it was killed")
            self.engine, self.under_way = LittleEngine(self.chance), []
            self.link.take_ready(READY)

    def step(self) -> None:
        self.engine.step()

    def end(self) -> None:
        for _ in range(4):
            self.send()
            while self.under_way:
                self.arrive()
            self.engine.step()
            while self.engine.said:
                self.hear()


@pytest.mark.parametrize("first", range(0, 600, 150))
def test_each_event_is_answered_once_and_each_session_ends(first: int) -> None:
    for seed in range(first, first + 150):
        story = Play(seed)
        ways = [story.send, story.arrive, story.step, story.hear]
        acts = [story.submit, story.submit, story.submit, *ways, story.lose]
        for _ in range(80):
            story.chance.choice(acts)()
        story.end()
        for client in story.clients.values():
            client.check()
        assert story.link.num_sessions == len(story.engine.open)
        kept = {name for name, held in vars(story.link._ledger).items() if isinstance(held, dict | set) and held}
        assert kept <= {"_entries", "_new"}, "the ledger keeps entries that nothing will remove"
