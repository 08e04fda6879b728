"""The order, the rate and the end of a session's events, which its stream checks before the engine sees them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import (
    ChannelBlock,
    Close,
    Closed,
    CloseReason,
    Code,
    Event,
    EventRefused,
    Guidance,
    ModelFacts,
    Open,
    Opened,
    Outcome,
    Playhead,
    Priority,
    RigLayout,
    SetPlayState,
    SetPrompts,
)
from motiongen_server.engine_process.ledger import no_room
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import prompt_texts
from motiongen_server.rpc.errors.events import too_many_fields
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.sessions import event_path
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.stream_metrics import StreamMetrics
from motiongen_server.rpc.streams.stream import Stream
from motiongen_server.text.turns import Asker

HANDLE = 7


def make_catalog(**limits: float) -> Catalog:
    rig = RigLayout("stick", ("root",), (-1,), np.zeros((1, 3), np.float32), (ChannelBlock("root_translation_m", 3),))
    facts = ModelFacts(
        model_id="tiny",
        rig=rig,
        fps=20,
        horizon=40,
        patch=4,
        feature_dim=8,
        max_window_frames=200,
        min_steps=2,
        max_steps=10,
        default_steps=4,
        embedding_dim=3,
    )
    return Catalog(facts, Limits(**limits), Guidance(2.0, 2.0), "CC0-1.0", text_encoder="counted", history_frames=16)  # type: ignore[arg-type]


@dataclass
class Prompts:
    """An encoder that encodes no text until the test sets `go`."""

    go: asyncio.Event = field(default_factory=asyncio.Event)
    asked: list[str] = field(default_factory=list)
    askers: list[Asker] = field(default_factory=list)

    def cached(self, text: str) -> NDArray[np.float32] | None:
        return np.ones(3, np.float32) if self.go.is_set() else None

    async def encode_all(self, texts: Sequence[str], asker: Asker) -> dict[str, NDArray[np.float32]]:
        self.asked += texts
        self.askers.append(asker)
        await self.go.wait()
        return {text: np.ones(3, np.float32) for text in texts}


@dataclass
class Engine:
    """Notes the events that it is given."""

    events: list[Event] = field(default_factory=list)
    most_steps: int = 1000

    def submit(self, event: Event) -> Outcome | None:
        self.events.append(event)
        return None

    def refusal_of(self, priority: Priority, denoise_steps: int) -> EventRefused | None:
        return no_room(priority, denoise_steps, 2.0) if denoise_steps > self.most_steps else None

    def kinds(self) -> list[type]:
        return [type(event) for event in self.events]


@dataclass
class Line:
    """A stream between a client and an engine, both played by the test. kept: sessions that outlive their streams."""

    catalog: Catalog = field(default_factory=make_catalog)
    engine: Engine = field(default_factory=Engine)
    prompts: Prompts = field(default_factory=Prompts)
    kept: KeptSessions | None = None
    number: int = 1
    metrics: StreamMetrics | None = None

    def __post_init__(self) -> None:
        self.models = ModelRegistry(LoadedModel("fake", self.engine, self.prompts, self.catalog))  # type: ignore[arg-type]
        self.stream = Stream(self.number, self.models, self.metrics, kept=self.kept)
        self.heard: list[session_pb2.SessionUpdate] = []

    def send(self, event_seq: int, at: float | None = None, **event: object) -> None:
        """at: when the event arrives, in monotonic seconds; None: now."""
        message = session_pb2.SessionEvent(session=HANDLE, event_seq=event_seq, **event)  # type: ignore[arg-type]
        self.stream.receive(message, time.monotonic() if at is None else at)

    def open(self) -> None:
        """Opens a session, and has the engine confirm it."""
        self.send(1, open=session_pb2.OpenSession(request_id="first"))
        self.stream.take(Opened(self.engine.events[-1].session, 1, 0, 40, 4, 4, "tiny", "stick", 20))

    async def encoded(self) -> None:
        """Lets the encoder run until nothing waits for it."""
        self.stream.ready.clear()
        self.prompts.go.set()
        await self.stream.ready.wait()

    async def texts_asked(self) -> list[str]:
        """The texts that the encoder was asked for, once every task has run that would ask it."""
        for _ in range(5):
            await asyncio.sleep(0)
        return self.prompts.asked

    def updates(self) -> list[session_pb2.SessionUpdate]:
        """All updates that the client was sent so far."""
        while (response := self.stream.next_response()) is not None:
            self.heard.extend(service_pb2.StreamMotionResponse.FromString(response).updates)
        return self.heard

    def refusals(self) -> list[tuple[int, str]]:
        """The number and the reason of each refused event."""
        outcomes = [update.outcome for update in self.updates() if update.HasField("outcome")]
        return [(outcome.event_seq, outcome.reason) for outcome in outcomes if outcome.code != Code.OK]


PAUSE = session_pb2.SetPlayState(state=session_pb2.PLAY_STATE_PAUSED)
WALK = session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan(prompt_id=1, text="walk")])


@pytest.fixture
async def line() -> Line:
    return Line()


async def test_repeated_event_is_dropped_and_a_gap_is_refused(line: Line) -> None:
    line.open()
    line.send(2, set_play_state=PAUSE)
    line.send(2, set_play_state=PAUSE)
    line.send(4, set_play_state=PAUSE)
    line.send(3, set_play_state=PAUSE)
    assert line.refusals() == [(4, "SEQUENCE_GAP")]
    assert [event.event_seq for event in line.engine.events] == [1, 2, 3]


async def test_repeated_open_is_dropped_and_a_different_one_is_refused(line: Line) -> None:
    line.open()
    line.send(1, open=session_pb2.OpenSession(request_id="first"))
    assert line.refusals() == []
    line.send(1, open=session_pb2.OpenSession(request_id="second"))
    assert line.refusals() == [(1, "HANDLE_IN_USE")]
    line.send(2, set_play_state=PAUSE)
    assert line.refusals() == [(1, "HANDLE_IN_USE")], "the open session is not affected"


async def test_playhead_with_a_number_is_refused_and_the_session_continues(line: Line) -> None:
    line.open()
    line.send(1, playhead=session_pb2.Playhead(frame=3))
    line.send(0, playhead=session_pb2.Playhead(frame=3))
    line.send(2, set_play_state=PAUSE)
    assert line.refusals() == [(1, "INVALID_EVENT_SEQ")]
    assert [event.event_seq for event in line.engine.events] == [1, 0, 2]


async def test_event_beyond_the_rate_limit_uses_up_its_number() -> None:
    line = Line(make_catalog(events_per_second=3.0))
    line.open()
    now = time.monotonic()  # all of them arrive at this moment, so that the budget is not replenished between two
    for event_seq in range(2, 6):
        line.send(event_seq, at=now, set_play_state=PAUSE)
    assert {reason for _, reason in line.refusals()} == {"TOO_MANY_EVENTS"}
    assert [event.event_seq for event in line.engine.events] + [seq for seq, _ in line.refusals()] == [1, 2, 3, 4, 5]


async def test_events_after_a_close_are_refused_before_closed_is_sent(line: Line) -> None:
    line.open()
    line.send(2, close=session_pb2.CloseSession())
    line.send(3, set_play_state=PAUSE)
    line.send(0, playhead=session_pb2.Playhead(frame=9))
    line.stream.take(Closed(line.engine.events[0].session, CloseReason.CLIENT, Code.OK, "", 0, 0))
    assert line.engine.kinds() == [Open, Close]
    assert line.refusals() == [(3, "SESSION_CLOSED")]
    last = line.updates()[-1]
    assert last.HasField("closed")
    assert last.applied_seq == 3


async def test_playhead_does_not_overtake_the_open(line: Line) -> None:
    line.send(1, open=session_pb2.OpenSession(prompts=WALK.upsert))
    line.send(0, playhead=session_pb2.Playhead(frame=0))
    assert line.engine.events == []
    await line.encoded()
    line.send(0, playhead=session_pb2.Playhead(frame=0))
    assert line.engine.kinds() == [Open, Playhead]


async def test_events_wait_behind_a_prompt_that_is_being_encoded(line: Line) -> None:
    line.open()
    line.send(2, edit_prompts=WALK)
    line.send(3, close=session_pb2.CloseSession())
    line.send(4, edit_prompts=WALK)
    assert line.engine.kinds() == [Open]
    await line.encoded()
    assert line.engine.kinds() == [Open, SetPrompts, Close]
    assert line.refusals() == [(4, "SESSION_CLOSED")]


async def test_prompts_are_checked_once_and_invalid_ones_refused_without_waiting(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked: list[int] = []

    def counted(event: session_pb2.SessionEvent, catalog: Catalog) -> tuple[str, ...]:
        checked.append(event.event_seq)
        return prompt_texts(event, catalog)

    monkeypatch.setattr(event_path, "prompt_texts", counted)
    line.open()
    line.send(2, edit_prompts=WALK)
    line.send(3, edit_prompts=session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan(prompt_id=1, text=" ")]))
    line.send(4, edit_prompts=WALK)
    assert line.refusals() == [(3, "EMPTY_PROMPT")]
    await line.encoded()
    assert [event.event_seq for event in line.engine.events] == [1, 2, 4]
    assert checked == [1, 2, 3, 4]


async def test_waiting_events_are_answered_when_their_stream_ends(line: Line) -> None:
    line.send(1, open=session_pb2.OpenSession(prompts=WALK.upsert))
    line.send(2, set_play_state=PAUSE)
    line.stream.close_all(CloseReason.DRAINED)
    assert line.refusals() == [(1, "SESSION_CLOSED"), (2, "SESSION_CLOSED")]
    assert line.stream.num_sessions == 0
    assert line.engine.events == []


async def test_event_with_too_many_fields_is_refused_and_uses_up_its_number(line: Line) -> None:
    unread = too_many_fields(4416)
    shell = session_pb2.SessionEvent(session=HANDLE, event_seq=2, edit_constraints=session_pb2.EditConstraints())
    opening = session_pb2.SessionEvent(session=HANDLE, event_seq=1, open=session_pb2.OpenSession())
    line.stream.receive(opening, time.monotonic(), unread)
    assert line.engine.events == [], "an open without its content opens nothing"
    line.open()
    line.stream.receive(shell, time.monotonic(), unread)
    line.send(3, set_play_state=PAUSE)
    assert line.refusals() == [(1, "TOO_MANY_FIELDS"), (2, "TOO_MANY_FIELDS")]
    assert line.engine.kinds() == [Open, SetPlayState]


async def test_event_with_too_many_fields_is_refused_without_a_session_too(line: Line) -> None:
    shell = session_pb2.SessionEvent(session=HANDLE, event_seq=2, edit_constraints=session_pb2.EditConstraints())
    line.stream.receive(shell, time.monotonic(), too_many_fields(4416))
    assert line.refusals() == [(2, "TOO_MANY_FIELDS")]


async def test_events_after_an_encoded_prompt_wait_only_for_later_prompts(line: Line) -> None:
    line.open()
    line.send(2, edit_prompts=WALK)
    await line.encoded()
    line.send(3, set_play_state=PAUSE)
    assert line.engine.kinds() == [Open, SetPrompts, SetPlayState]
    line.prompts.go.clear()
    line.send(4, edit_prompts=WALK)
    line.send(5, set_play_state=PAUSE)
    assert len(line.engine.events) == 3
    await line.encoded()
    assert line.engine.kinds()[3:] == [SetPrompts, SetPlayState]
