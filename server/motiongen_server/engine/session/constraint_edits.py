"""Applies edits of constraints to a session's conditions, and places the constraints that leave that to the engine."""

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
    """Apply an edit of constraints. floor: the first frame that can still change; anchor: the state to place them from.

    Returns the new conditions, every constraint that was added, removed or replaced, and the placements of those that
    left them to the engine. Raises EventRefused for an unknown id, a target that has passed, more than `limit`
    constraints, or trajectories of more than most_frames together.
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
        # If it may be met at any of several frames, one that can still change is enough.
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
    """Of items with the same id only the last, in the order in which these came."""
    held: dict[int, Named] = {}
    for item in items:
        held.pop(item.constraint_id, None)
        held[item.constraint_id] = item
    return tuple(held.values())


def of_last(placements: Iterable[Placement], asked: Iterable[Asked]) -> tuple[Placement, ...]:
    """The placements of those constraints that remain of all that were asked for."""
    left_open = {item.constraint_id for item in by_last(asked) if isinstance(item, Unplaced)}
    return tuple(each for each in by_last(placements) if each.constraint_id in left_open)


def place_all(
    asked: Sequence[Asked], anchor: Callable[[], Anchor], field: str, most_frames: int
) -> tuple[tuple[Constraint, ...], tuple[Placement, ...]]:
    """The constraints in absolute frames and world coordinates, and placements of those that left them to the engine.

    field: the path of their list. Raises EventRefused for one that cannot be placed, and, before any more are placed,
    once the trajectories have more than most_frames together.
    """
    constraints: list[Constraint] = []
    frames = 0
    placements: list[Placement] = []
    here: Anchor | None = None  # made on demand: most edits need none, and it costs a pose
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
    """The frames of a trajectory, each of which has a place; other constraints need no more memory for more frames."""
    return len(constraint.xz) if isinstance(constraint, RootTrajectory) else 0
