import numpy as np
import pytest

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.constraint_edits import edit_constraints
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.types import Code, EventRefused, RootTrajectory, SessionKey, SetConstraints, Waypoint

KEY = SessionKey(1, 1)


def here() -> Anchor:
    """The anchor, for which no constraint of these tests may ask."""
    raise AssertionError


def _constraints(
    *upsert: Waypoint | RootTrajectory, remove: tuple[int, ...] = (), clear: bool = False
) -> SetConstraints:
    return SetConstraints(KEY, 1, 0.0, upsert, remove, clear)


def test_constraint_edit_returns_all_added_and_removed_constraints() -> None:
    old = Waypoint(1, 50, 0.0, 0.0)
    path = RootTrajectory(2, 60, np.zeros((10, 2), np.float32))
    new = Waypoint(1, 80, 1.0, 0.0)
    edited, changed, _ = edit_constraints(Conditions((), (old, path)), _constraints(new, remove=(2,)), 10, 9, 99, here)
    assert edited.constraints == (new,)
    assert set(changed) == {old, path, new}
    edited, changed, _ = edit_constraints(Conditions((), (old, path)), _constraints(clear=True), 10, 9, 99, here)
    assert (edited.constraints, changed) == ((), (old, path))


@pytest.mark.parametrize(
    ("event", "floor", "limit", "refusal", "allowed"),
    [
        (_constraints(remove=(6,)), 0, 9, (Code.NOT_FOUND, "UNKNOWN_CONSTRAINT", "edit_constraints.remove[0]"), "5"),
        (
            _constraints(remove=(5,), clear=True),
            0,
            9,
            (Code.NOT_FOUND, "UNKNOWN_CONSTRAINT", "edit_constraints.remove[0]"),
            "none",
        ),
        (
            _constraints(Waypoint(6, 19, 0.0, 0.0)),
            20,
            9,
            (Code.FAILED_PRECONDITION, "FRAME_COMMITTED", "edit_constraints.upsert[0].frame"),
            "from 20",
        ),
        (
            _constraints(Waypoint(6, 20, 0.0, 0.0)),
            20,
            1,
            (Code.RESOURCE_EXHAUSTED, "TOO_MANY_CONSTRAINTS", "edit_constraints.upsert"),
            "1",
        ),
    ],
)
def test_a_refused_edit_says_what_is_allowed(
    event: SetConstraints, floor: int, limit: int, refusal: tuple[Code, str, str], allowed: str
) -> None:
    with pytest.raises(EventRefused) as caught:
        edit_constraints(Conditions((), (Waypoint(5, 90, 0.0, 0.0),)), event, floor, limit, 99, here)
    outcome = caught.value.outcome(KEY, 3)
    assert (outcome.code, outcome.reason, outcome.field) == refusal
    assert allowed in outcome.allowed
    assert outcome.event_seq == 3
