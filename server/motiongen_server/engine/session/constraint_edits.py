"""What an edit of constraints makes of a session's conditions, and where those that leave it open are put."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TypeVar

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.edit_refusals import passed, too_many, too_many_frames, unknown
from motiongen_server.engine.session.placing import Anchor, placed
from motiongen_server.engine.types import Asked, Constraint, Placement, RootTrajectory, SetConstraints, Unplaced

Named = TypeVar("Named", Asked, Constraint, Placement)


def edit_constraints(
    held: Conditions, event: SetConstraints, floor: int, limit: int, most_frames: int, anchor: Callable[[], Anchor]
) -> tuple[Conditions, tuple[Constraint, ...], tuple[Placement, ...]]:
    """Apply an edit of constraints. floor: the first frame that can still change; anchor: for what asks "from here".

    Returns the new conditions, every constraint that came, went or was replaced, and where those that left it open
    were put. Raises EventRefused for an unknown id, a target that has passed, more than `limit` constraints, or
    trajectories of more than most_frames together.
    """
    constraints = {item.constraint_id: item for item in held.constraints}
    changed: list[Constraint] = []
    if event.clear:
        changed.extend(constraints.values())
        constraints.clear()
    for index, constraint_id in enumerate(event.remove):
        if constraint_id not in constraints:
            raise unknown("constraint", constraint_id, index, constraints)
        changed.append(constraints.pop(constraint_id))
    upserts, placements = place_all(event.upsert, anchor, "edit_constraints.upsert", most_frames)
    for index, item in enumerate(upserts):
        # Of several frames at which it may be met one that still can be is enough.
        latest = item.first_frame if isinstance(item, RootTrajectory) else item.last_frame
        if latest < floor:
            field = f"edit_constraints.upsert[{index}].frame"
            raise passed("constraint", item.constraint_id, latest, floor, field, floor)
        replaced = constraints.pop(item.constraint_id, None)
        changed.extend([item] if replaced is None else [item, replaced])
        constraints[item.constraint_id] = item
    if len(constraints) > limit:
        raise too_many("constraints", len(constraints), limit)
    if (frames := sum(map(_trajectory_frames, constraints.values()))) > most_frames:
        raise too_many_frames(frames, most_frames, "edit_constraints.upsert")
    return replace(held, constraints=tuple(constraints.values())), tuple(changed), of_last(placements, event.upsert)


def by_last(items: Iterable[Named]) -> tuple[Named, ...]:
    """Those that hold of items with ids, in the order in which they came: of several with one id the last."""
    held: dict[int, Named] = {}
    for item in items:
        held.pop(item.constraint_id, None)
        held[item.constraint_id] = item
    return tuple(held.values())


def of_last(placements: Iterable[Placement], asked: Iterable[Asked]) -> tuple[Placement, ...]:
    """The placements of what holds of all that was asked for."""
    left_open = {item.constraint_id for item in by_last(asked) if isinstance(item, Unplaced)}
    return tuple(each for each in by_last(placements) if each.constraint_id in left_open)


def place_all(
    asked: Sequence[Asked], anchor: Callable[[], Anchor], field: str, most_frames: int
) -> tuple[tuple[Constraint, ...], tuple[Placement, ...]]:
    """Constraints as they are asked for, in frames and in the world; and where those were put that left it open.

    field: the path of their list. Raises EventRefused for one that cannot be placed, and for trajectories of more than
    most_frames together, before any more of them are worked out.
    """
    constraints: list[Constraint] = []
    frames = 0
    placements: list[Placement] = []
    here: Anchor | None = None  # most edits need none, and it costs a pose
    for index, item in enumerate(asked):
        if isinstance(item, Unplaced):
            here = here or anchor()
            constraint, placement = placed(item, here, f"{field}[{index}]")
            constraints.append(constraint)
            placements.append(placement)
        else:
            constraints.append(item)
        frames += _trajectory_frames(constraints[-1])
        if frames > most_frames:
            raise too_many_frames(frames, most_frames, f"{field}[{index}]")
    return tuple(constraints), tuple(placements)


def _trajectory_frames(constraint: Constraint) -> int:
    """That it says a place for, each of its own; other constraints take no more memory the longer they hold."""
    return len(constraint.xz) if isinstance(constraint, RootTrajectory) else 0
