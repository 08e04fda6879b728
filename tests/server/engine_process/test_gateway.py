"""An engine in a process of its own behaves as one in this process, within the same limits."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from motiongen_server.engine.types import Chunk, Closed, CloseReason, Opened, Outcome, Owner, SessionKey
from motiongen_server.engine_process.messages import StepsElsewhere, ToEngine
from motiongen_server.engine_process.process import EngineProcess
from tests.server.engine.fakes import FRAME, PLAN, SEED
from tests.server.engine_process.audience import KEY, LIMIT_S, close, opening, play, playhead, remote
from tests.waiting import until


def test_session_plays_from_open_to_close() -> None:
    with remote() as there:
        engine, audience = there.engine, there.audience
        assert engine.submit(opening(seed=7)) is None
        audience.wait_for_frames(40)
        assert type(audience.outputs[0]) is Opened
        assert engine.submit(playhead(30)) is None
        audience.wait_for_frames(60)
        rows = [row for chunk in audience.of(Chunk) if isinstance(chunk, Chunk) for row in chunk.rows]
        assert [row[FRAME] for row in rows[:40]] == list(range(40))
        assert {row[SEED] for row in rows} == {7}
        assert rows[0][PLAN] == 1
        assert engine.submit(play(2)) is None
        audience.wait_for(lambda heard: heard.answers() == [(2, "OK")])
        assert engine.num_sessions == 1
        assert engine.submit(close(3)) is None
        assert audience.wait_for_end().reason is CloseReason.CLIENT
        assert engine.num_sessions == 0
        audience.wait_for(lambda heard: sum(len(report.opens) for report in heard.reports) == 1)
        assert engine.failure is None


def test_refusals_of_the_engine_are_passed_on_and_its_limits_hold() -> None:
    other = SessionKey(1, 2)
    with remote("small") as there:
        engine, audience = there.engine, there.audience
        for event in (opening(), opening(other), play(2, other), close(3, other), play(2)):
            assert engine.submit(event) is None
        audience.wait_for(lambda heard: heard.answers() == [(2, "OK")] and len(heard.answers(other)) == 3)
        codes = dict(audience.answers(other))
        assert codes[1] == "RESOURCE_EXHAUSTED"
        assert sorted(codes) == [1, 2, 3]
        assert "OK" not in codes.values()
        assert engine.num_sessions == 1


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, StepsElsewhere]]:
    """What each engine process is told about steps taken on others, in order."""
    told: list[tuple[str, StepsElsewhere]] = []
    tell = EngineProcess.tell

    def note(process: EngineProcess, message: ToEngine) -> bool:
        if isinstance(message, StepsElsewhere):
            told.append((process.name, message))
        return tell(process, message)

    monkeypatch.setattr(EngineProcess, "tell", note)
    return told


def test_engines_are_told_of_steps_that_an_owner_with_a_quota_took_elsewhere(
    told: list[tuple[str, StepsElsewhere]],
) -> None:
    owner = Owner("studio", 2.0, 1200.0)
    with remote(engines=2) as there:
        there.engine.submit(opening(SessionKey(1, 2)))  # its owner has no quota, so its steps are not counted
        event = opening()
        there.engine.submit(replace(event, spec=replace(event.spec, owner=owner)))
        there.audience.wait_for_frames(40)
        until(lambda: told)
        there.engine.submit(playhead(30))  # the session still plays afterwards
        there.audience.wait_for_frames(60)
    num_steps = event.spec.denoise_steps
    assert {name for name, _ in told[:2]} == {"0", "1"}
    assert sorted(message.slot for _, message in told[:2]) == [0, 1], "the engine itself is not charged twice"
    assert all(message.taken == ((owner, num_steps),) for _, message in told[:2])


def test_changed_quota_of_an_owner_reaches_its_engine(
    told: list[tuple[str, StepsElsewhere]],
) -> None:
    before, after = Owner("studio", 2.0, 1200.0), Owner("studio", 1.0, 900.0)
    numbers = itertools.count(1)
    with remote() as there:

        def another_is_of(owner: Owner) -> bool:
            """Opens one more session for the owner as it was before; the steps counted for it are told soon after."""
            event = opening(SessionKey(1, next(numbers)))
            assert there.engine.submit(replace(event, spec=replace(event.spec, owner=before))) is None
            there.audience.wait_for_frames(40, event.session)
            return any(message.taken[0][0] == owner for _, message in told)

        until(lambda: another_is_of(before))
        there.engine.note_owner(after)
        until(lambda: another_is_of(after))


def test_events_for_a_stopped_engine_are_limited_and_none_is_lost() -> None:
    with remote() as there:
        engine, audience = there.engine, there.audience
        engine.submit(opening())
        audience.wait_for_frames(40)
        with there.stopped():
            refused: Outcome | None = None
            seq = 1
            while refused is None and seq < 100_000:
                seq += 1
                refused = engine.submit(play(seq))
        assert refused is not None, "no event was refused"
        assert refused.reason == "TOO_MANY_PENDING_EVENTS"
        audience.wait_for(lambda heard: len(heard.answers()) == seq - 2)
        assert audience.answers() == [(number, "OK") for number in range(2, seq)]


def test_events_that_a_close_overtakes_are_answered_before_the_end() -> None:
    with remote() as there:
        engine, audience = there.engine, there.audience
        engine.submit(opening())
        audience.wait_for_frames(40)
        with there.stopped():
            taken = [seq for seq in range(2, 40) if engine.submit(play(seq)) is None]
            assert engine.submit(close(40)) is None
        audience.wait_for_end()
        assert sorted(seq for seq, _ in audience.answers()) == taken
        assert type(audience.outputs[-1]) is Closed


def test_session_key_can_be_reused_at_once() -> None:
    with remote() as there:
        engine, audience = there.engine, there.audience
        for seed in range(1, 6):
            engine.submit(opening(seed=seed))
            engine.submit(close(2))
            audience.wait_for(lambda heard, number=seed: len(heard.of(Closed)) == number)
        engine.submit(opening(seed=9))
        audience.wait_for(lambda heard: any(c.rows[0, SEED] == 9 for c in heard.of(Chunk)))  # type: ignore[attr-defined]
        assert engine.num_sessions == 1


def test_draining_engine_opens_no_session_and_a_stopped_one_closes_its_own() -> None:
    other = SessionKey(1, 2)
    with remote() as there:
        engine, audience = there.engine, there.audience
        engine.submit(opening())
        audience.wait_for_frames(40)
        engine.drain()
        refusal = engine.submit(opening(other))
        assert refusal is not None
        assert (refusal.code.name, refusal.reason) == ("UNAVAILABLE", "DRAINING")
        engine.submit(playhead(30))
        audience.wait_for_frames(60)
    assert audience.wait_for_end(KEY).reason is CloseReason.DRAINED
    assert engine.failure is None


def test_limit_of_sessions_applies_to_all_engines_together() -> None:
    third = SessionKey(1, 3)
    with remote(engines=2, max_sessions=2) as there:
        for key in (KEY, SessionKey(1, 2)):
            assert there.engine.submit(opening(key)) is None
        refusal = there.engine.submit(opening(third))
        assert refusal is not None
        assert (refusal.code.name, refusal.reason) == ("RESOURCE_EXHAUSTED", "SESSION_LIMIT")
        there.engine.submit(close(2))
        there.audience.wait_for_end()
        assert there.engine.submit(opening(third)) is None
        there.audience.wait_for_frames(40, third)


def test_model_is_unloaded_while_another_plays() -> None:
    other = SessionKey(1, 2)
    with remote() as there:
        second = there.pool.load("second")
        there.engine.submit(opening())
        second.submit(opening(other))
        there.audience.wait_for_frames(40)  # Otherwise the playhead below would lie beyond the sent frames and be cut.
        there.audience.wait_for_frames(40, other)
        assert (there.engine.num_sessions, second.num_sessions) == (1, 1)
        assert second.facts.model_id == "second"
        second.stop()
        assert second.join(LIMIT_S)
        assert there.audience.wait_for_end(other).reason is CloseReason.DRAINED
        there.engine.submit(playhead(30))
        there.audience.wait_for_frames(60)
