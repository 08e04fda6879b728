"""Wishes of a session, as they are sent to a reopened one, and events shifted to another first frame."""

from __future__ import annotations

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client.frame_shift import shifted
from motiongen_client.wishes import Wishes


def span(prompt_id: int, text: str, start: int = 0, end: int = 0) -> motion_pb2.PromptSpan:
    return motion_pb2.PromptSpan(prompt_id=prompt_id, text=text, start_frame=start, end_frame=end)


def prompts(*upsert: motion_pb2.PromptSpan, remove: tuple[int, ...] = ()) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_prompts=session_pb2.EditPrompts(upsert=upsert, remove=remove))


def waypoint(constraint_id: int, frame: int) -> motion_pb2.Constraint:
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, waypoint=motion_pb2.Waypoint(x=1))


def path(constraint_id: int, frame: int, length: int) -> motion_pb2.Constraint:
    positions = [float(number) for number in range(2 * length)]
    target = motion_pb2.RootTrajectory(positions=positions, headings=positions[:length])
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, root_trajectory=target)


def constraints(*upsert: motion_pb2.Constraint, clear: bool = False) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_constraints=session_pb2.EditConstraints(upsert=upsert, clear=clear))


def test_shifted_prompts_start_at_0_once_begun_and_are_dropped_once_ended() -> None:
    moved = shifted(prompts(span(1, "now"), span(2, "then", 30, 90), span(3, "over", 0, 20)), 40)
    assert moved is not None
    assert [(each.text, each.start_frame, each.end_frame) for each in moved.edit_prompts.upsert] == [
        ("now", 0, 0),
        ("then", 0, 50),
    ]


def test_shifted_constraints_are_dropped_once_passed_and_trajectories_are_cut() -> None:
    moved = shifted(constraints(waypoint(1, 30), waypoint(2, 50), path(3, 36, 10), path(4, 20, 10)), 40)
    assert moved is not None
    left = {each.constraint_id: each for each in moved.edit_constraints.upsert}
    assert {key: each.frame for key, each in left.items()} == {2: 10, 3: 0}
    assert list(left[3].root_trajectory.positions[:2]) == [8, 9]
    assert list(left[3].root_trajectory.headings) == [4, 5, 6, 7, 8, 9]


def test_shifted_event_with_nothing_left_is_none() -> None:
    assert shifted(constraints(waypoint(1, 30)), 40) is None
    assert shifted(prompts(span(1, "over", 0, 40)), 40) is None
    assert shifted(constraints(clear=True), 40) is not None
    assert shifted(prompts(remove=(1,)), 40) is not None


def test_prompts_that_have_begun_end_with_the_one_in_force() -> None:
    wishes = Wishes()
    wishes.take_opening(session_pb2.OpenSession(prompts=[span(1, "first"), span(2, "later", 30)]))
    wishes.take(prompts(span(3, "much later", 100)), 100, 0)
    wishes.take(prompts(span(1, "second")), 20, 10)
    assert [(each.text, each.start_frame) for each in wishes.prompts_from(50, 16)] == [
        ("second", 0),
        ("later", 0),
        ("much later", 50),
    ]
    wishes.take(prompts(remove=(2,)), 60, 55)
    assert [each.text for each in wishes.prompts_from(60, 16)] == ["second", "much later"]


def spans_from(wishes: Wishes, frame: int, most: int = 16) -> list[tuple[str, int, int]]:
    return [(each.text, each.start_frame, each.end_frame) for each in wishes.prompts_from(frame, most)]


def test_prompt_in_force_continues_until_the_one_that_replaces_it() -> None:
    wishes = Wishes()
    wishes.take_opening(session_pb2.OpenSession(prompts=[span(1, "walk")]))
    wishes.take(prompts(span(1, "run", 200)), 200, 10)
    assert spans_from(wishes, 150) == [("walk", 0, 50), ("run", 50, 0)]
    assert spans_from(wishes, 150, 1) == [("run", 50, 0)], "fewer prompts may be sent"
    assert spans_from(wishes, 200) == [("run", 0, 0)]
    wishes.take(prompts(span(1, "jump", 300)), 300, 20)  # "run" never began
    assert spans_from(wishes, 150) == [("walk", 0, 150), ("jump", 150, 0)]
    wishes.take(prompts(span(1, "sit")), 40, 30)
    assert spans_from(wishes, 35) == [("walk", 0, 5), ("sit", 5, 0)], "the outcome names a frame still to come"
    wishes.take(prompts(span(2, "wave", 50, 60)), 50, 45)
    wishes.take(prompts(span(3, "nod", 80, 90)), 80, 70)
    assert spans_from(wishes, 50) == [("sit", 0, 0), ("nod", 30, 40)], "prompts that have ended are forgotten"


def test_only_constraints_in_force_and_still_ahead_are_kept() -> None:
    wishes = Wishes()
    wishes.take_opening(session_pb2.OpenSession(constraints=[waypoint(1, 20), waypoint(2, 90)]))
    wishes.take(constraints(waypoint(3, 70)), 60, 50)
    assert [(each.constraint_id, each.frame) for each in wishes.constraints_from(60)] == [(2, 30), (3, 10)]
    wishes.take(constraints(clear=True), 60, 50)
    assert wishes.constraints_from(0) == []


def test_velocity_is_repeated_for_its_remaining_frames_and_a_pause_too() -> None:
    wishes = Wishes()
    velocity = session_pb2.SetVelocity(x=1, hold_frames=20)
    wishes.take(session_pb2.SessionEvent(set_velocity=velocity), 40, 30)
    (told,) = wishes.events_from(50)
    assert (told.set_velocity.x, told.set_velocity.hold_frames) == (1, 10)
    assert wishes.events_from(60) == []
    pause = session_pb2.SetPlayState(state=session_pb2.PLAY_STATE_PAUSED)
    wishes.take(session_pb2.SessionEvent(set_play_state=pause), 40, 30)
    assert [event.WhichOneof("event") for event in wishes.events_from(60)] == ["set_play_state"]


def test_cut_still_ahead_is_repeated_before_the_velocity() -> None:
    wishes = Wishes()
    cut = session_pb2.Seek(start_pose=session_pb2.StartPose(x=5))
    wishes.take(session_pb2.SessionEvent(seek=cut), 70, 50)
    wishes.take(session_pb2.SessionEvent(set_velocity=session_pb2.SetVelocity(x=1, hold_frames=90)), 75, 50)
    told = wishes.events_from(65)
    assert [event.WhichOneof("event") for event in told] == ["seek", "set_velocity"]
    assert told[0].seek == cut
    assert [event.WhichOneof("event") for event in wishes.events_from(71)] == ["set_velocity"]


def test_shifted_seek_counts_from_the_new_first_frame() -> None:
    moved = shifted(session_pb2.SessionEvent(seek=session_pb2.Seek(frame=50)), 40)
    assert moved is not None
    assert moved.seek.frame == 10
    assert shifted(session_pb2.SessionEvent(seek=session_pb2.Seek(frame=40)), 40) is None
    pose = session_pb2.SessionEvent(seek=session_pb2.Seek(start_pose=session_pb2.StartPose(x=1)))
    assert shifted(pose, 40) == pose
