"""Resumes that an engine cannot continue: the session lives on without its client, and its outputs are kept."""

from __future__ import annotations

import pytest

from motiongen_server.engine.types import Closed, CloseReason, Code, Outcome, Output, Resumed, SessionKey
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from tests.server.rpc.sessions.test_kept_sessions import resume, token_of
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, Line

KEY = SessionKey(1, HANDLE)
REFUSED = Resumed(KEY, 1, None)
ANSWERED = Outcome(KEY, 2, Code.OK)
ENDED = Closed(KEY, CloseReason.IDLE, Code.OK, "", 0, 0)


@pytest.mark.parametrize("at_once", [True, False])
async def test_outputs_after_a_refused_resume_are_kept_for_the_parked_session(at_once: bool) -> None:
    kept = KeptSessions(30.0)
    line = Line(kept=kept)
    line.open()
    line.send(2, set_play_state=PAUSE)
    token, peer = token_of(line), line.stream.peer
    other = resume(kept, line.engine, token)
    said: tuple[Output, ...] = (REFUSED, ANSWERED, ENDED)
    if at_once:
        other.stream.take(*said)
    else:
        other.stream.take(REFUSED)
        carrier = kept.carrier_of(KEY)
        assert carrier is not None
        carrier.take(*said[1:])
    assert other.refusals() == [(1, "RESUME_OUT_OF_RANGE")]
    assert len(other.updates()) == 1, "the refused stream gets no outputs of the session"
    assert (kept.num_parked, peer.num_sessions) == (1, 0), (
        "it has ended, and its client may still come and learn of that"
    )
    again = resume(kept, line.engine, token, attempt=2)
    assert [update.WhichOneof("update") for update in again.updates()] == ["opened", "outcome", "closed"]
    assert (kept.num_parked, kept.has_away) == (0, False)
