"""Targets set, replaced and removed in random orders, with lost connections: no caller waits for one that is gone."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from random import Random

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import InvalidInput, Session, StreamLost, Waypoint, convert
from tests.client.line import Line, answer, frames, open_session, opened, told
from tests.client.synthetic import HORIZON, catalog

STEPS = 80
PASSED = 9  # FAILED_PRECONDITION


@dataclass
class Served:
    """A session as one server has it: the frames of its targets by id, outcomes told, and answers given."""

    last_seq: int = 1
    targets: dict[int, int] = field(default_factory=dict)
    told: list[tuple[int, int]] = field(default_factory=list)
    answers: list[session_pb2.SessionUpdate] = field(default_factory=list)
    num_plans: int = 0

    def take(self, event: session_pb2.SessionEvent, is_accepted: bool) -> None:
        """Answer an edit, unless it was answered before."""
        if event.event_seq <= self.last_seq:
            return
        assert event.event_seq == self.last_seq + 1, "a server refuses a gap"
        self.last_seq += 1
        edit = event.edit_constraints
        if not is_accepted or any(key not in self.targets for key in edit.remove):
            self.answers.append(answer(event.event_seq, code=PASSED, reason="NO_LUCK"))
            return
        for key in edit.remove:
            del self.targets[key]
        self.targets |= {target.constraint_id: target.frame for target in edit.upsert}
        self.answers.append(answer(event.event_seq, effective_frame=0))


class World:
    """A session, its connection and the server; updates under way between them may be lost."""

    def __init__(self, session: Session, line: Line, random: Random) -> None:
        self.session, self.line, self.random = session, line, random
        self.served = Served()
        self.kept: Served | None = self.served
        self.num_heard = len(line.said)
        self.under_way: list[session_pb2.SessionUpdate] = []
        self.waiting: list[tuple[int, asyncio.Task[object]]] = []
        self.dropped: set[int] = set()

    def say(self) -> None:
        """Edit targets as an application does; a reopened session refuses frames of the past."""
        with contextlib.suppress(InvalidInput):
            self.say_something()

    def say_something(self) -> None:
        """Raises InvalidInput."""
        session, frame = self.session, self.session.playback.playhead + self.random.randrange(1, 4 * HORIZON)
        kind, ids = self.random.random(), sorted({key for key, _ in self.waiting})
        if kind < 0.6 or not ids:
            count = self.random.randrange(1, 4)
            ids = list(
                session.add_constraints([Waypoint(frame + each, 1.0, 2.0) for each in range(count)]).constraint_ids
            )
        elif kind < 0.8:
            ids = [self.random.choice(ids)]
            session.replace_constraint(ids[0], Waypoint(frame, 3.0, 4.0))
        else:
            ids = [self.random.choice(ids)]
            session.remove_constraints(ids)
            self.dropped |= set(ids)
        self.waiting += [(key, asyncio.ensure_future(session.constraint_reached(key))) for key in ids]

    def hear(self) -> None:
        """The server handles the events that it has received, and answers."""
        for event in self.line.said[self.num_heard :]:
            if event.HasField("edit_constraints"):
                self.served.take(event, self.random.random() < 0.9)
                self.under_way += self.served.answers[-1:]
        self.num_heard = len(self.line.said)

    def deliver(self) -> None:
        """The session receives some or all of the updates under way."""
        count = self.random.randrange(len(self.under_way) + 1)
        for update in self.under_way[:count]:
            self.session.hear(update)
        del self.under_way[:count]

    def go_on(self) -> None:
        """Frames come and are shown, and their targets are reached."""
        self.hear()
        while self.under_way:
            self.deliver()
        playback, offset = self.session.playback, self.session.playback.buffered_to
        self.served.num_plans += 1
        first_frame = offset - self.session.opened.start_frame
        for update in frames(self.served.num_plans, first_frame):
            self.session.hear(update)
        playback.advance_to(offset + HORIZON // 2)
        reached = {key: frame for key, frame in self.served.targets.items() if frame < first_frame + HORIZON // 2}
        for key, frame in reached.items():
            del self.served.targets[key]
            self.served.told.append((key, frame))
            self.under_way.append(told(key, frame))

    def lose(self) -> None:
        """Lose the connection, with the updates under way; the next server has kept the session or not."""
        if self.random.random() < 0.5:
            self.hear()
        self.under_way.clear()
        self.session.interrupt()
        for _ in range(self.random.randrange(3)):
            self.say()
        self.num_heard = len(self.line.said)
        self.session.reattach(convert.catalog(catalog(100)))
        if self.random.random() < 0.5:
            self.session.hear(opened())
            for update in (*self.served.answers, *(told(*each) for each in self.served.told)):
                self.session.hear(update)
            return
        self.session.hear(answer(1, code=5, reason="SESSION_NOT_KEPT"))
        opening = self.line.said[-1].open
        self.served = Served(targets={target.constraint_id: target.frame for target in opening.constraints})
        self.num_heard = len(self.line.said)
        self.session.hear(opened())


@pytest.mark.parametrize("seed", range(60))
async def test_every_awaited_target_is_at_the_server_or_has_an_outcome(seed: int) -> None:
    line = Line()
    session = await open_session(line)
    world = World(session, line, Random(seed))
    acts: list[Callable[[], None]] = [world.say, world.say, world.hear, world.deliver, world.go_on, world.lose]
    for _ in range(STEPS):
        world.random.choice(acts)()
        if world.random.random() < 0.5:
            await asyncio.sleep(0)
    world.hear()
    while world.under_way:
        world.deliver()
    for _ in range(3):
        await asyncio.sleep(0)
    nowhere = {key for key, task in world.waiting if not task.done()} - set(world.served.targets) - world.dropped
    assert nowhere == set(), "no server will report them"
    for key in set(world.served.targets) - world.dropped:
        asking = asyncio.ensure_future(session.constraint_reached(key))
        await asyncio.sleep(0)
        assert not asking.done(), f"target {key} is still ahead"
        world.waiting.append((key, asking))
    session.fail(StreamLost("UNAVAILABLE", "for good"))
    await asyncio.gather(*(task for _, task in world.waiting), return_exceptions=True)
