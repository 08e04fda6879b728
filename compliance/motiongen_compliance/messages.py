"""Short builders for the messages that the suite sends."""

from __future__ import annotations

from collections.abc import Sequence

from motiongen.v1 import motion_pb2, session_pb2


def span(text: str = "walk", prompt_id: int = 1, start: int = 0, end: int = 0) -> motion_pb2.PromptSpan:
    return motion_pb2.PromptSpan(prompt_id=prompt_id, start_frame=start, end_frame=end, text=text)


def waypoint(frame: int, constraint_id: int = 1, **root: float) -> motion_pb2.Constraint:
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, waypoint=motion_pb2.Waypoint(**root))


def edit_prompts(*upsert: motion_pb2.PromptSpan, remove: Sequence[int] = ()) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_prompts=session_pb2.EditPrompts(upsert=upsert, remove=remove))


def edit_constraints(*upsert: motion_pb2.Constraint, remove: Sequence[int] = ()) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_constraints=session_pb2.EditConstraints(upsert=upsert, remove=remove))


def play_state(state: int) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(set_play_state=session_pb2.SetPlayState(state=state))  # type: ignore[arg-type]


def close() -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(close=session_pb2.CloseSession())


PAUSE = play_state(session_pb2.PLAY_STATE_PAUSED)


RESUME = play_state(session_pb2.PLAY_STATE_PLAYING)


def addressed(event: session_pb2.SessionEvent, handle: int, event_seq: int) -> session_pb2.SessionEvent:
    """A copy of an event with a handle and a number."""
    copy = session_pb2.SessionEvent()
    copy.CopyFrom(event)
    copy.session, copy.event_seq = handle, event_seq
    return copy
