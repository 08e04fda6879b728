"""Binary messages with the rows of all characters, and rigs in JSON."""

from __future__ import annotations

import json
import math
import struct

import numpy as np

from motiongen_client import Motion, Rig
from motiongen_tools.view.wire import Head, pack_frames, pack_history, pack_motion, rig_json, to_json


def unpack(message: bytes) -> tuple[dict, np.ndarray]:
    (length,) = struct.unpack_from("<I", message)
    assert length % 4 == 0, "rows must be aligned for a browser to view them as numbers"
    return json.loads(message[4 : 4 + length]), np.frombuffer(message[4 + length :], "<f4")


def test_rows_of_all_characters_follow_one_another(stick_motion: Motion) -> None:
    rows = list(stick_motion.rows)
    heads = [Head(1, 3.25, 20, 8, 12, 4, rows[:3]), Head(7, 0, 0, 0, 2, 2, []), Head(9, 1, 20, 5, 9, 1, rows[5:6])]
    header, numbers = unpack(pack_frames(heads))
    assert header["heads"] == [[1, 3.25, 20, 8, 12, 4, 3], [7, 0, 0, 0, 2, 2, 0], [9, 1, 20, 5, 9, 1, 1]]
    np.testing.assert_array_equal(numbers, np.concatenate([*rows[:3], rows[5]]))


def test_the_widths_of_rows_are_sent(stick_motion: Motion) -> None:
    """So that a page that does not know a character still finds the rows of the next one."""
    narrow = stick_motion.rows[0, :5]
    heads = [
        Head(1, 0, 0, 0, 1, 0, [narrow]),
        Head(2, 0, 0, 0, 0, 0, []),
        Head(3, 0, 0, 0, 1, 0, [stick_motion.rows[1]]),
    ]
    header, numbers = unpack(pack_frames(heads))
    assert header["widths"] == [5, 0, 43]
    np.testing.assert_array_equal(numbers[5:], stick_motion.rows[1])


def test_numbers_that_are_not_finite_become_null() -> None:
    said = {"a": [1.5, math.nan, {"b": (math.inf, -math.inf, 2)}], "c": "NaN", "d": True}
    assert to_json(said) == '{"a":[1.5,null,{"b":[null,null,2]}],"c":"NaN","d":true}'


def test_a_motion_is_sent_with_its_rig(stick_motion: Motion) -> None:
    header, numbers = unpack(pack_motion("walk.bvh", stick_motion))
    assert (header["name"], header["num_frames"]) == ("walk.bvh", 40)
    assert header["rig"] == rig_json(stick_motion.rig)
    np.testing.assert_array_equal(numbers.reshape(40, -1), stick_motion.rows)


def test_history_is_sent_with_its_first_frame(stick_motion: Motion) -> None:
    header, numbers = unpack(pack_history(3, 17, list(stick_motion.rows[:2])))
    assert (header["character"], header["first_frame"], header["num_frames"]) == (3, 17, 2)
    assert len(numbers) == 2 * stick_motion.rig.row_width


def test_columns_of_a_rig_are_those_of_its_rows(stick_rig: Rig) -> None:
    described = rig_json(stick_rig)
    assert described["columns"] == {
        "root_translation_m": [0, 3],
        "joint_rotation_quat_wxyz": [3, 39],
        "foot_contact": [39, 43],
    }
    assert described["row_width"] == 43
    json.dumps(described)
