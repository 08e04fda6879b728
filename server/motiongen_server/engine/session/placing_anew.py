"""Placing anew: constraints relative to the character are placed where the window that answers them really starts.

When an event comes, the start of that window is only predicted. It may be later, because another window is finished
first, replans are spaced, or the window came too late and is made again. Meanwhile the character has moved on, or its
frames before that window have changed.
"""

from __future__ import annotations

from dataclasses import replace

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.edits import PendingEdit
from motiongen_server.engine.session.placing import Anchor, placed
from motiongen_server.engine.types import Constraint, EventRefused, Placement


def placed_anew(
    conditions: Conditions, edits: tuple[PendingEdit, ...], anchor: Anchor
) -> tuple[Conditions, tuple[PendingEdit, ...]]:
    """The conditions and edits for a window from anchor.frame on, with the edits' left-open constraints placed there.

    Constraints that another event has replaced or removed since, or that cannot be placed there, stay as they are.
    """
    held = {id(item): item for item in conditions.constraints}
    moved: dict[int, Constraint] = {}
    renewed = []
    for edit in edits:
        items, placements = [], {each.constraint_id: each for each in edit.placements}
        for asked, before in edit.left_open:
            found = before
            if id(before) in held and not anchor.is_of(placements[asked.constraint_id]):
                try:
                    found, placement = placed(asked, anchor, "")
                except EventRefused:  # a path that has become too long to walk in these few frames
                    placement = placements[asked.constraint_id]
                placements[asked.constraint_id] = placement
                moved[id(before)] = found
            items.append((asked, found))
        told: tuple[Placement, ...] = tuple(placements.values())
        renewed.append(replace(edit, left_open=tuple(items), placements=told) if items else edit)
    if not moved:
        return conditions, edits
    constraints = tuple(moved.get(id(item), item) for item in conditions.constraints)
    return replace(conditions, constraints=constraints), tuple(renewed)
