"""Targets of a take in the JSON that motion tools exchange."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from motiongen_client import Motion
from motiongen_tools.constraint_file import read_constraints
from motiongen_tools.view.constraint_list import write_constraint_list
from motiongen_tools.view.script import Target


def target(key: int, is_removed: bool = False, **spec: Any) -> Target:
    return Target(key, spec, None, is_removed)


def test_root_and_heading_are_written_and_the_rest_is_told(stick_motion: Motion, tmp_path: Path) -> None:
    later = Motion(stick_motion.rig, 100, stick_motion.rows)  # frames 100 to 139
    text, left_out = write_constraint_list(
        [
            target(1, kind="waypoint", frame=110, x_m=1.0, z_m=2.0, heading_rad=0.5),
            target(2, kind="waypoint", frame=500, x_m=1.0, z_m=2.0),
            target(3, kind="waypoint", frame=120, x_m=9.0, z_m=9.0, is_removed=True),
            target(4, kind="trajectory", first_frame=138, positions_m=[[0, 1], [0, 2], [0, 3]]),
            target(5, kind="heading", frame=120, heading_rad=1.0),
        ],
        later,
    )
    waypoint, path = json.loads(text)
    assert waypoint == {
        "type": "root2d",
        "frame_indices": [10],
        "root_2d": [[1.0, 2.0]],
        "global_root_heading": [0.5],
    }
    assert (path["frame_indices"], path["root_2d"]) == ([38, 39], [[0, 1], [0, 2]])
    assert left_out == ["constraint 5: the list has no words for this heading"]
    (tmp_path / "list.json").write_text(text)
    assert len(read_constraints(tmp_path / "list.json", later.rig, 40)) == 2
