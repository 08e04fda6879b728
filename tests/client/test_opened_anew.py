"""What a reopened session is sent: all that is still in force, once each, however often the connection is lost."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import Session, SessionEnded, convert
from tests.client.line import Line, answer, frames, open_anew, open_with_frames, opened, said_since_opened
from tests.client.synthetic import HORIZON, ROW_WIDTH, catalog, synthetic_rows


@pytest.fixture
async def line() -> Line:
    return Line()


@pytest.fixture
async def session(line: Line) -> Session:
    return await open_with_frames(line)


async def test_each_reopening_sends_velocity_and_pending_cut_once(session: Session, line: Line) -> None:
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


async def test_constraint_at_any_frame_is_sent_at_each_reopening_until_reached(session: Session, line: Line) -> None:
    edit = session.go_to(1.0, 2.0)
    (key,) = edit.constraint_ids

    def put(first_frame: int) -> motion_pb2.ConstraintPlacement:
        frames = {"first_frame": first_frame, "last_frame": first_frame + 50, "arrival_frame": first_frame + 45}
        return motion_pb2.ConstraintPlacement(constraint_id=key, anchor_frame=first_frame, **frames)

    session.hear(answer(2, effective_frame=10, placements=[put(10)]))
    for _ in range(3):
        open_anew(session, line, put(5))
        (asked,) = next(event for event in reversed(line.said) if event.HasField("open")).open.constraints
        assert asked.at_any_frame
        for update in frames(1):
            session.hear(update)


async def test_each_reopening_sends_the_remaining_corners_of_a_path(session: Session, line: Line) -> None:
    """Each walks 40 frames, and the placement that it answers says how many corners it passes in them."""
    edit = session.follow_path([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [4.0, 0.0]])

    def put(anchor_x_m: float, last_frame: int) -> motion_pb2.ConstraintPlacement:
        return motion_pb2.ConstraintPlacement(
            constraint_id=edit.constraint_ids[0], last_frame=last_frame, anchor_x=anchor_x_m
        )

    session.hear(answer(2, effective_frame=0, placements=[put(0.0, 115)]))
    for left in ([2.0, 0.0, 3.0, 0.0, 4.0, 0.0], [3.0, 0.0, 4.0, 0.0], [4.0, 0.0]):
        open_anew(session, line, put(left[0] - 0.75, 20 * len(left)))
        (asked,) = next(event for event in reversed(line.said) if event.HasField("open")).open.constraints
        assert list(asked.root_path.positions) == left
        for update in frames(1):
            session.hear(update)


async def test_session_reopened_with_another_rig_is_closed_at_the_server_too(session: Session, line: Line) -> None:
    session.set_prompt("a person runs")
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    anew = opened()
    anew.opened.rig_id = "stick10"
    session.hear(anew)
    with pytest.raises(SessionEnded, match="its rig, stick9, is not served any more"):
        session.set_prompt("a person waves")
    (closing,) = said_since_opened(line)
    assert closing == session_pb2.SessionEvent(session=1, event_seq=2, close=session_pb2.CloseSession())


@pytest.mark.parametrize("is_taken", [True, False])
async def test_prompt_removed_while_disconnected_is_removed_again_only_if_refused(
    session: Session, line: Line, is_taken: bool
) -> None:
    """A server refuses an edit that removes a prompt it does not have, and with it the prompt that was set."""
    scheduled = session.set_prompt("a person waves", frame=10)
    session.hear(answer(2, effective_frame=10))
    session.playback.advance_to(20)
    setting = session.set_prompt("a person walks")
    open_anew(session, line)
    (said,) = said_since_opened(line)
    assert list(said.edit_prompts.remove) == [scheduled.prompt_id]
    session.hear(answer(2, effective_frame=0) if is_taken else answer(2, code=3, reason="NO_WAY"))
    assert setting.done()
    for update in frames(1):
        session.hear(update)
    session.playback.advance_to(HORIZON + 5)
    session.set_prompt("a person runs")
    assert list(line.said[-1].edit_prompts.remove) == ([] if is_taken else [scheduled.prompt_id])


async def test_reopened_session_is_resumed_in_the_frame_numbers_of_its_server(session: Session, line: Line) -> None:
    open_anew(session, line)
    sent, chunk = frames(1)
    chunk.chunk.committed_to = 9
    for update in (sent, chunk):
        session.hear(update)
    session.playback.advance_to(HORIZON + 5)
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    point = line.said[-1].open.resume_point
    assert (point.next_frame, point.playhead, point.committed_to) == (HORIZON, 5, 9)
    assert (point.plan, point.answered_seq, point.attempt) == (1, 1, 1)


async def test_history_and_the_rest_of_a_reopening_fit_into_one_message_of_any_limit(
    session: Session, line: Line
) -> None:
    known = catalog(100)
    known.models[0].default_history_frames, known.models[0].patch_frames = HORIZON, 1
    for limit in range(3000, 3000 + 5 * ROW_WIDTH):  # more than a row's bytes
        known.limits.max_request_bytes = limit
        session.interrupt()
        session.reattach(convert.catalog(known))
        said = line.said[-1]
        assert said.open.prior_frames.frame_count > 10
        assert said.ByteSize() <= limit * 9 // 10, "the session would end"


async def test_history_of_a_reopening_begins_at_the_last_cut(session: Session, line: Line) -> None:
    cut, chunk = frames(2, HORIZON)
    cut.plan.cause = session_pb2.PLAN_CAUSE_CUT
    chunk.chunk.frame_count = 2
    chunk.chunk.data = chunk.chunk.data[: 2 * 4 * ROW_WIDTH]
    session.hear(cut)
    session.hear(chunk)
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    prior = line.said[-1].open.prior_frames
    rows = np.frombuffer(prior.data, "<f4").reshape(prior.frame_count, ROW_WIDTH)
    expected = synthetic_rows(2, HORIZON, 2)[[0, 0, 0, 1]]  # a window sees four: the first is repeated
    assert (rows == expected).all()


@pytest.mark.parametrize("changed", ["outputs", "width"])
async def test_session_ends_if_the_rows_of_the_next_server_differ(session: Session, line: Line, changed: str) -> None:
    offered = catalog(100)
    if changed == "width":
        offered.rigs[0].blocks.add(name="more", width=2)
    session.interrupt()
    session.reattach(convert.catalog(offered))
    anew = opened()
    if changed == "outputs":
        anew.opened.outputs.add(name="joint_positions_m", width=3 * session.rig.num_joints)
    session.hear(anew)
    with pytest.raises(SessionEnded, match="model_unloaded"):
        session.set_prompt("run")
    assert line.said[-1].HasField("close")


async def test_durability_is_called_back_when_it_changes(session: Session) -> None:
    told: list[bool] = []
    session.on_durability = told.append
    for is_kept in (False, True, True, False):
        saved = session_pb2.SessionDurability(is_kept=is_kept)
        session.hear(session_pb2.SessionUpdate(session=1, durability=saved))
    assert told == [True, False]
