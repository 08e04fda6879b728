"""A session without a stream: its events are recorded, and a test passes it the server's updates."""

from __future__ import annotations

import asyncio
import time

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import convert
from motiongen_client.backlog import Backlog
from motiongen_client.errors import EventRefused
from motiongen_client.session import Session
from motiongen_client.types import SessionOptions
from tests.client.synthetic import HORIZON, catalog, synthetic_rows
from tests.client.waiting import until

TOKEN = "a-token.1"


class Line:
    """Takes the place of a stream: records the events that a session sends."""

    call_number = 1
    is_connected = True
    draining = False
    recovers = True

    def __init__(self) -> None:
        self.said: list[session_pb2.SessionEvent] = []
        self.backlog = Backlog()

    def check(self, event: session_pb2.SessionEvent) -> None:
        """Every event fits into a message."""

    def send(self, event: session_pb2.SessionEvent) -> None:
        copied = session_pb2.SessionEvent()
        copied.CopyFrom(event)
        self.said.append(copied)

    def report_soon(self) -> None:
        """Playheads are not reported here."""

    def move_elsewhere(self, handle: int, refusal: EventRefused) -> bool:
        return False


def opened(token: str = TOKEN) -> session_pb2.SessionUpdate:
    return session_pb2.SessionUpdate(
        session=1,
        opened=session_pb2.SessionOpened(
            session_id="s1", seed=7, rig_id="stick9", model_id="synthetic", lookahead_frames=40, denoise_steps=4,
            session_token=token,
        ),
    )  # fmt: skip


def frames(plan: int, first_frame: int = 0) -> list[session_pb2.SessionUpdate]:
    """A plan and all its frames."""
    rows = synthetic_rows(plan, first_frame, HORIZON)
    chunk = motion_pb2.FrameChunk(
        plan=plan,
        first_frame=first_frame,
        frame_count=len(rows),
        committed_to=first_frame,
        data=rows.astype("<f4").tobytes(),
        scalar_type=motion_pb2.SCALAR_TYPE_F32_LE,
    )
    notice = session_pb2.PlanNotice(plan=plan, valid_from=first_frame, cause=session_pb2.PLAN_CAUSE_CONTINUE)
    return [session_pb2.SessionUpdate(session=1, plan=notice), session_pb2.SessionUpdate(session=1, chunk=chunk)]


def answer(event_seq: int, **what: object) -> session_pb2.SessionUpdate:
    """The outcome of an event: accepted, or refused if there is a code."""
    outcome = session_pb2.EditOutcome(event_seq=event_seq, **what)  # type: ignore[arg-type]
    return session_pb2.SessionUpdate(session=1, outcome=outcome)


def told(constraint_id: int, frame: int) -> session_pb2.SessionUpdate:
    """An update which says that a constraint was met."""
    reached = session_pb2.ConstraintReached(constraint_id=constraint_id, met=True, frame=frame)
    return session_pb2.SessionUpdate(session=1, constraint_reached=reached)


async def open_session(line: Line, token: str = TOKEN) -> Session:
    """token: "" for a server that resumes no sessions."""
    session = Session(1, line, convert.catalog(catalog(100)), time.monotonic)
    opening = asyncio.create_task(session.begin(SessionOptions(), None, {}, [], None))
    await until(lambda: line.said)
    session.hear(opened(token))
    await opening
    return session


async def open_with_frames(line: Line) -> Session:
    """A session of a server that keeps no sessions, with frames up to HORIZON."""
    session = await open_session(line, token="")
    for update in frames(1):
        session.hear(update)
    return session


def said_since_opened(line: Line) -> list[session_pb2.SessionEvent]:
    """The events after the newest OpenSession, which may be one that resumes."""
    (*_, opening) = [number for number, event in enumerate(line.said) if event.HasField("open")]
    return line.said[opening + 1 :]


def open_anew(session: Session, line: Line, *placements: motion_pb2.ConstraintPlacement) -> None:
    """Lose the connection, and reopen the session at a server that has not kept it, after the frames that it holds."""
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    if line.said[-1].open.resume_token:
        session.hear(answer(1, code=5, reason="SESSION_NOT_KEPT"))
    anew = opened()
    anew.opened.placements.extend(placements)
    session.hear(anew)
