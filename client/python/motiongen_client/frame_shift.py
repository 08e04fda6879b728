"""Shifts events from the application's frame numbers to those of a session that was opened anew. Pure."""

from __future__ import annotations

from motiongen.v1 import motion_pb2, session_pb2


def shifted(event: session_pb2.SessionEvent, offset: int) -> session_pb2.SessionEvent | None:
    """The event for a session whose frame 0 is the application's frame `offset`. Prompts that have begun start at 0.

    Constraints at earlier frames are left out. None if nothing is left of the event.
    """
    if not offset:
        return event
    moved = session_pb2.SessionEvent()
    moved.CopyFrom(event)
    match event.WhichOneof("event"):
        case "edit_prompts":
            del moved.edit_prompts.upsert[:]
            moved.edit_prompts.upsert.extend(
                span for each in event.edit_prompts.upsert if (span := shifted_span(each, offset)) is not None
            )
            asked, left = len(event.edit_prompts.upsert), len(moved.edit_prompts.upsert)
            return None if asked and not left and not moved.edit_prompts.remove else moved
        case "edit_constraints":
            del moved.edit_constraints.upsert[:]
            moved.edit_constraints.upsert.extend(
                target
                for each in event.edit_constraints.upsert
                if (target := shifted_constraint(each, offset)) is not None
            )
            edit = moved.edit_constraints
            is_empty = not edit.upsert and not edit.remove and not edit.clear
            return None if event.edit_constraints.upsert and is_empty else moved
        case "seek":
            if 0 < event.seek.frame <= offset:
                return None
            moved.seek.frame = max(event.seek.frame - offset, 0)
        case "playhead":
            moved.playhead.frame = max(event.playhead.frame - offset, 0)
            moved.playhead.buffered_to = max(event.playhead.buffered_to - offset, 0)
    return moved


def passed_targets(event: session_pb2.SessionEvent, offset: int) -> list[int]:
    """The ids of the constraints that `shifted` leaves out of an event."""
    return [each.constraint_id for each in event.edit_constraints.upsert if shifted_constraint(each, offset) is None]


def shifted_span(span: motion_pb2.PromptSpan, offset: int) -> motion_pb2.PromptSpan | None:
    """The span for such a session; None if it has ended before."""
    if span.end_frame and span.end_frame <= offset:
        return None
    moved = motion_pb2.PromptSpan()
    moved.CopyFrom(span)
    moved.start_frame = max(span.start_frame - offset, 0)
    if span.end_frame:
        moved.end_frame = span.end_frame - offset
    return moved


def shifted_constraint(target: motion_pb2.Constraint, offset: int) -> motion_pb2.Constraint | None:
    """The constraint for such a session: of a begun trajectory, the rest; without frames, unchanged; None if passed."""
    moved = motion_pb2.Constraint()
    moved.CopyFrom(target)
    kind = target.WhichOneof("target")
    if target.at_any_frame or target.frames_from_effect or kind == "root_path":
        return moved
    behind = offset - target.frame
    if target.HasField("last_frame"):
        if target.last_frame < offset:
            return None
        moved.frame, moved.last_frame = max(-behind, 0), target.last_frame - offset
        return moved
    if behind <= 0:
        moved.frame = -behind
        return moved
    if kind != "root_trajectory" or 2 * behind >= len(target.root_trajectory.positions):
        return None
    moved.frame = 0
    del moved.root_trajectory.positions[: 2 * behind]
    del moved.root_trajectory.headings[:behind]
    return moved
