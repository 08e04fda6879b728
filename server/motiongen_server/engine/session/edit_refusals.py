"""The refusals of edits of prompts or constraints."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.engine.types import Code, EventRefused


def unknown(what: str, given: int, index: int, held: Iterable[int]) -> EventRefused:
    """An edit removes an id that is not set. what: "prompt" or "constraint"; index: its position in `remove`."""
    listed = ", ".join(map(str, sorted(held)[:16])) or "none"
    return EventRefused(
        Code.NOT_FOUND,
        f"UNKNOWN_{what.upper()}",
        f"{what} {given} is not set: it never was, was removed, or can change no frame any more; leave it out",
        f"edit_{what}s.remove[{index}]",
        f"the ids that are set: {listed}",
    )


def passed(what: str, given: int, frame: int, floor: int, field: str, least: int) -> EventRefused:
    """An edit asks for frames before floor, which cannot change any more.

    given: the id; frame: the last frame that it asks for; least: the least value that the field may have instead.
    """
    return EventRefused(
        Code.FAILED_PRECONDITION,
        "FRAME_COMMITTED",
        f"{what} {given} asks for frame {frame}, but frames below {floor} cannot change any more; choose a later frame",
        field,
        f"a frame from {least} on",
    )


def too_many(what: str, given: int, limit: int) -> EventRefused:
    """A session would have more than its limit. what: "prompts" or "constraints"."""
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        f"TOO_MANY_{what.upper()}",
        f"the session would hold {given} {what}; remove some or reuse their ids",
        f"edit_{what}.upsert",
        f"at most {limit} {what} at once",
    )


def too_many_frames(given: int, limit: int, field: str) -> EventRefused:
    """Root trajectories would have more frames together than a session may hold."""
    return EventRefused(
        Code.RESOURCE_EXHAUSTED,
        "TOO_MANY_TRAJECTORY_FRAMES",
        f"trajectories and paths would have {given} frames together; send the later ones when earlier ones are over",
        field,
        f"at most {limit} frames at once (max_held_trajectory_frames)",
    )
