"""What it costs a stream to resume sessions, again and again."""

from __future__ import annotations

from motiongen_server.rpc.budgets.stream_budget import RESUME_COST
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from tests.server.rpc.sessions.test_kept_sessions import resume, token_of
from tests.server.rpc.streams.test_event_order import Line


async def test_each_resume_is_charged_since_frames_are_sent_again_for_it() -> None:
    """A client could otherwise have 50 look-aheads a second written for each of its sessions."""
    kept = KeptSessions(30.0)
    line = Line(kept=kept)
    line.open()
    token = token_of(line)
    for attempt in (1, 2):
        other = resume(kept, line.engine, token, attempt)
        assert other.stream.budget.charged == RESUME_COST


async def test_a_lost_stream_of_the_most_sessions_is_resumed_within_a_tenth_of_a_second() -> None:
    limits = Line().catalog.limits
    wait_s = limits.max_sessions_per_stream * (1 + RESUME_COST) / limits.stream_events_per_second - 1
    assert wait_s < 0.1, "of the burst of one second, this much is left to be waited for"
