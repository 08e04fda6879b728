"""Messages of pages and session files: values that the contract cannot hold are refused before they are sent."""

from __future__ import annotations

from typing import Any

import pytest

from motiongen_client.errors import InvalidInput
from motiongen_tools.view.commands import read

PLACE = {"kind": "joint_targets", "frame": 9, "joints": [4], "positions_m": [[0, 1, 0]]}
FOOT = {"kind": "foot_contact", "frame": 9, "limb": 5, "x_m": 0, "z_m": 0}


def constraint(**changes: Any) -> dict[str, Any]:
    return {"op": "add_constraints", "constraints": [{**PLACE, **changes}]}


@pytest.mark.parametrize(
    ("message", "field"),
    [
        (constraint(joints=["LeftHand"]), "joints"),
        (constraint(joints=[-1]), "joints"),
        (constraint(joints=[True]), "joints"),
        (constraint(joints=[1 << 32]), "joints"),
        (constraint(joints={"4": 4}), "joints"),
        (constraint(frame=10**20), "frame"),
        (constraint(last_frame=10**20), "last_frame"),
        (constraint(is_relative="yes"), "is_relative"),
        (constraint(at_any_frame=None), "at_any_frame"),
        ({"op": "add_constraints", "constraints": [FOOT]}, "limb"),
        ({"op": "set_constraints", "constraints": [{}]}, "kind"),
        ({"op": "replace_constraint", "constraint_id": 10**20, "constraint": PLACE}, "constraint_id"),
        ({"op": "remove_constraints", "constraint_ids": [10**20]}, "constraint_ids"),
        ({"op": "remove_prompts", "prompt_ids": [10**20]}, "prompt_ids"),
        ({"op": "remove_prompts", "prompt_ids": [[1]]}, "prompt_ids"),
        ({"op": "set_prompt", "text": "run", "prompt_id": [1]}, "prompt_id"),
        ({"op": "set_prompt", "text": "\ud800"}, "text"),
        ({"op": "set_prompt", "preset": "\ud800"}, "preset"),
        ({"op": "set_velocity", "x_mps": 10**400, "z_mps": 0}, "x_mps"),
        ({"op": "set_velocity", "x_mps": 0, "z_mps": float("nan")}, "z_mps"),
        ({"op": ["pause"]}, "op"),
    ],
)
def test_values_that_cannot_be_sent_are_refused_with_their_field(message: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        read(message)
    assert refused.value.field == field


def test_fields_that_an_operation_does_not_take_are_ignored() -> None:
    for operation in ("clear_constraints", "pause", "resume"):
        assert callable(read({"op": operation, "constraints": [{}], "prompt_id": [1]}))
