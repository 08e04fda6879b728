"""What a session is told that is opened anew: all that holds, each thing once, however often the line is lost."""

from __future__ import annotations

import pytest

from motiongen.v1 import session_pb2
from motiongen_client import Session
from tests.client.line import Line, answer, frames, open_anew, open_session
from tests.client.synthetic import HORIZON


@pytest.fixture
async def line() -> Line:
    return Line()


@pytest.fixture
async def session(line: Line) -> Session:
    """Of a server that keeps none, with frames up to HORIZON."""
    session = await open_session(line, token="")
    for update in frames(1):
        session.hear(update)
    return session


def said_since_opened(line: Line) -> list[session_pb2.SessionEvent]:
    """What the newest session was told behind its opening."""
    (*_, opening) = [number for number, event in enumerate(line.said) if event.HasField("open")]
    return line.said[opening + 1 :]


async def test_what_holds_is_said_once_where_the_line_is_lost_again_before_an_answer(
    session: Session, line: Line
) -> None:
    session.set_velocity(1.0, 0.0, seconds=2.0)
    session.hear(answer(2, effective_frame=10))  # to frame 210
    waiting = session.teleport(5.0, 0.0)
    for number in range(1, 4):
        open_anew(session, line)
        velocity, cut = said_since_opened(line)
        assert velocity.set_velocity.hold_frames == 210 - number * HORIZON
        assert cut.seek.HasField("start_pose")
        assert [velocity.event_seq, cut.event_seq, waiting.event_seq] == [2, 3, 3]
        for update in frames(1):
            session.hear(update)
