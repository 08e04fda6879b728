"""Frames and plans. `Heard` checks the rules of order on every message; these tests provoke the important cases."""

from __future__ import annotations

import numpy as np

from motiongen.v1 import session_pb2
from motiongen_compliance.messages import PAUSE, RESUME, edit_prompts, span
from motiongen_compliance.target import Target


async def test_silent_client_gets_one_lookahead_of_frames_and_no_more(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    assert heard.opened is not None
    lookahead = heard.opened.lookahead_frames
    await talk.until(lambda: heard.end == lookahead)
    await talk.open(2)
    await talk.plays_on(2)
    await talk.ping(1)
    assert heard.end == lookahead, "frames came without credit"


async def test_playhead_extends_the_credit(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    assert heard.opened is not None
    lookahead = heard.opened.lookahead_frames
    # a playhead may jump by up to one look-ahead, so each of these earns its credit at once
    for playhead in (lookahead // 6, lookahead // 2, lookahead - 1):
        await talk.until(lambda playhead=playhead: heard.end >= playhead)
        await talk.report(1, playhead)
        await talk.until(lambda playhead=playhead: heard.end == playhead + lookahead)


async def test_playhead_that_goes_back_is_ignored(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    assert heard.opened is not None
    lookahead = heard.opened.lookahead_frames
    shown = lookahead // 2
    await talk.until(lambda: heard.end >= shown)
    await talk.report(1, shown)
    await talk.report(1, shown // 6)
    await talk.until(lambda: heard.end == shown + lookahead)
    await talk.plays_on(1)


async def test_windows_follow_each_other_as_plans_that_replace_nothing(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    while heard.end < 200:
        await talk.plays_on(1)
    assert heard.plans[0].valid_from == 0
    assert {plan.cause for plan in heard.plans} == {session_pb2.PLAN_CAUSE_CONTINUE}
    assert all(not plan.event_seqs for plan in heard.plans)
    ends = [chunk.first_frame + chunk.frame_count for chunk in heard.chunks]
    assert ends == sorted(ends)
    assert len(heard.plans) >= 4


async def test_edit_makes_a_plan_that_names_it_and_starts_at_its_effective_frame(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1, prompts=[span("stand")])
    outcome = await talk.edit(1, edit_prompts(span("run fast")))
    plan = next(plan for plan in heard.plans if outcome.event_seq in plan.event_seqs)
    assert plan.cause == session_pb2.PLAN_CAUSE_EDIT
    assert outcome.HasField("effective_frame")
    assert outcome.effective_frame == plan.valid_from
    await talk.until(lambda: heard.chunks[-1].plan >= plan.plan and heard.next_frame > plan.valid_from)
    assert heard.applied_seq == 2


async def test_edits_do_not_change_committed_frames(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1, prompts=[span("stand")])
    for index in range(6):
        await talk.plays_on(1)
        committed = heard.committed_to
        outcome = await talk.edit(1, edit_prompts(span("again " * (index + 1))))
        assert outcome.code == 0
        assert outcome.HasField("effective_frame")
        assert outcome.effective_frame >= committed
    assert len([plan for plan in heard.plans if plan.cause == session_pb2.PLAN_CAUSE_EDIT]) >= 3


async def test_paused_session_gets_its_lookahead_and_continues_when_played(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    assert (await talk.edit(1, PAUSE)).code == 0
    assert heard.opened is not None
    await talk.until(lambda: heard.end == heard.opened.lookahead_frames)  # type: ignore[union-attr]
    outcome = await talk.edit(1, RESUME)
    assert (outcome.code, outcome.HasField("effective_frame")) == (0, False)
    await talk.plays_on(1)


async def test_same_seed_gives_the_same_motion_beside_other_sessions(target: Target) -> None:
    talk = await target.talk()
    first = await talk.open(1, seed=11, prompts=[span("walk")])
    for handle in (2, 3, 4):
        await talk.open(handle, seed=handle)
    again = await talk.open(5, seed=11, prompts=[span("walk")])
    assert first.opened is not None
    num_frames = first.opened.lookahead_frames
    await talk.until(lambda: min(first.end, again.end) >= num_frames)
    rows = [np.stack([np.frombuffer(heard.frames[n], "<f4") for n in range(num_frames)]) for heard in (first, again)]
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-4)
