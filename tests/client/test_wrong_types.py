"""Values of wrong types, passed to constructors: each is refused by name, with what is allowed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from motiongen_client import (
    ChannelSettings,
    Flexible,
    FootContact,
    FrameFormat,
    HeadingTarget,
    InvalidInput,
    JointRotations,
    JointTargets,
    Keyframe,
    LinePolicy,
    Motion,
    MotionClient,
    Playback,
    Preset,
    Priority,
    RootPath,
    RootTrajectory,
    SessionOptions,
    StartPose,
    TextEmbedding,
    Waypoint,
    blocking,
    camera_relative,
    convert,
    drawn_corners,
    stick_velocity,
)
from tests.client.synthetic import rig, synthetic_rows
from tests.client.wrong_values import (
    ABOVE_0,
    FINE,
    FLAG,
    NO_ITEMS,
    NONE,
    NUMBER,
    PLACE,
    TEXT,
    TOLERANCES,
    WHOLE,
    Made,
    is_refused,
    name_of,
    taken,
    wrong,
)


def motion() -> Motion:
    return Motion(convert.rig(rig(20)), 0, synthetic_rows(1, 0, 8))


CONSTRAINTS = [
    Made(Waypoint, {"frame": 30, "x_m": 1, "z_m": 2}, {"frame": WHOLE, **PLACE, **TOLERANCES}),
    Made(
        RootTrajectory,
        {"first_frame": 30, "positions_m": np.zeros((3, 2))},
        {"first_frame": WHOLE, "positions_m": set(), "headings_rad": NONE, **TOLERANCES},
    ),
    Made(
        Keyframe,
        {"frame": 30, "positions_m": np.zeros((9, 3))},
        {"frame": WHOLE, "positions_m": set(), **TOLERANCES},
    ),
    Made(
        JointTargets,
        {"frame": 30, "joints": [0], "positions_m": [[0, 0, 0]]},
        {"frame": WHOLE, "joints": set(), "positions_m": set(), "rotations_quat_wxyz": NONE, **TOLERANCES},
    ),
    Made(HeadingTarget, {"frame": 30, "heading_rad": 1}, {"frame": WHOLE, "heading_rad": NUMBER, **TOLERANCES}),
    Made(
        JointRotations,
        {"frame": 30, "joints": [0], "rotations_quat_wxyz": [[1, 0, 0, 0]]},
        {"frame": WHOLE, "joints": set(), "rotations_quat_wxyz": set(), **TOLERANCES},
    ),
    Made(
        RootPath,
        {"corners_m": [[0, 0]]},
        {"corners_m": set(), "speed_mps": NUMBER | NONE, "smoothing_m": NUMBER | NONE, **TOLERANCES},
    ),
    Made(
        FootContact,
        {"frame": 30, "limb": "LeftFoot", "x_m": 1, "z_m": 2},
        {"frame": WHOLE, "limb": TEXT, **PLACE, **TOLERANCES},
    ),
    Made(
        Flexible,
        {"target": FINE},
        {
            "target": set(), "last_frame": NONE, "at_any_frame": FLAG, "frames_from_effect": FLAG, "is_relative": FLAG,
            "weight": {"float", "None"},
        },
    ),
]  # fmt: skip
OTHERS = [
    Made(StartPose, {}, {"x_m": NUMBER, "z_m": NUMBER, "heading_rad": NUMBER}),
    Made(
        SessionOptions,
        {},
        {
            "model_id": TEXT | NONE, "rig_id": TEXT | NONE, "seed": NONE, "priority": set(), "lookahead_frames": NONE,
            "denoise_steps": NONE, "text_guidance": NUMBER | NONE, "constraint_guidance": NUMBER | NONE, "start": set(),
            "history_frames": NONE, "prior": NONE, "keep_prompts": FLAG, "frame_format": set(),
            "outputs": {*NO_ITEMS, "texts", "array of texts"},
        },
    ),
    Made(Preset, {}, {"preset_id": {"text"}}),
    Made(
        TextEmbedding,
        {"values": [0.5], "text_encoder": "x"},
        {"values": {"[]", "numbers"}, "text_encoder": TEXT, "text": TEXT},
    ),
    Made(
        LinePolicy,
        {},
        {
            "recover_s": {*ABOVE_0, "inf", "None"},
            **{name: {*ABOVE_0, "inf"} for name in ("hello_timeout_s", "ping_s", "pong_timeout_s")},
        },
    ),
    Made(Motion, {"rig": motion().rig, "first_frame": 0, "rows": motion().rows}, {"rig": set(), "rows": set()}),
    Made(
        Playback,
        {"frame_rate_hz": 20, "row_width": 2},
        {
            "frame_rate_hz": {*ABOVE_0}, "row_width": WHOLE, "start_frame": WHOLE,
            "keep_frames": {*ABOVE_0, "inf", "None"},
        },
    ),
    Made(
        stick_velocity,
        {"right": 0.5, "forward": 0.5},
        {**dict.fromkeys(("right", "forward", "camera_heading_rad", "speed_mps"), NUMBER), "dead_zone": set()},
    ),
    Made(
        camera_relative,
        {"right_m": 1.0, "forward_m": 1.0, "camera_heading_rad": 1.0},
        dict.fromkeys(("right_m", "forward_m", "camera_heading_rad"), NUMBER),
    ),
    Made(
        drawn_corners,
        {"points_m": [[0, 0], [1, 1]]},
        {"points_m": set(), "within_m": {*ABOVE_0, "inf"}},
    ),
]  # fmt: skip
LINE = {
    "address": set(), "credentials": NONE, "token": {"text", "function", "None"}, "metadata": NO_ITEMS,
}  # fmt: skip
CLIENT = {
    **LINE, "channel_options": NO_ITEMS, "connect_timeout_s": {*NUMBER, "inf"}, "policy": NONE,
    "other_addresses": {*NO_ITEMS, "texts", "array of texts", "function"},
}  # fmt: skip
LINES = [
    Made(ChannelSettings, {"address": "localhost:1"}, {**LINE, "options": NO_ITEMS}),
    Made(lambda value: ChannelSettings("localhost:1", metadata=[value]), {}, {"value": set()}),
    Made(lambda value: ChannelSettings("localhost:1", metadata=[("a", value)]), {}, {"value": {"text"}}),
    Made(lambda value: ChannelSettings("localhost:1", options=[value]), {}, {"value": set()}),
    Made(
        lambda value: ChannelSettings("localhost:1", options=[("grpc.a", value)]),
        {},
        {"value": {*TEXT, "bytes", "bool", "negative"}},
    ),
    Made(lambda value: ChannelSettings("localhost:1", options=[(value, 1)]), {}, {"value": TEXT}),
    Made(MotionClient, {"address": "localhost:1"}, CLIENT),
    Made(blocking.MotionClient, {"address": "localhost:1"}, CLIENT),
    Made(lambda value: MotionClient("localhost:1", other_addresses=[value]), {}, {"value": TEXT}),
]


@pytest.mark.parametrize("made", [*CONSTRAINTS, *OTHERS, *LINES], ids=name_of)
def test_values_of_wrong_types_are_refused_and_valid_ones_accepted(made: Made) -> None:
    for name, label, arguments in wrong(made):
        assert is_refused(lambda: made.of(**arguments)), f"{name} takes {label}"  # noqa: B023  called at once
    for arguments in taken(made):
        made.of(**arguments)


@pytest.mark.parametrize("made", CONSTRAINTS, ids=name_of)
def test_every_accepted_constraint_value_can_be_sent(made: Made) -> None:
    for arguments in taken(made):
        asked: Any = made.of(**arguments)
        assert convert.constraint(1, asked).IsInitialized()


def test_every_accepted_option_value_can_be_sent() -> None:
    (made,) = [each for each in OTHERS if each.of is SessionOptions]
    for arguments in taken(made):
        assert convert.open_session(SessionOptions(**arguments), [], []).IsInitialized()


def test_errors_about_token_and_metadata_do_not_print_the_secret() -> None:
    for wrong_one in ({"token": ["secret"]}, {"metadata": ["secret"]}, {"metadata": [("a", b"secret")]}):
        with pytest.raises(InvalidInput) as refused:
            ChannelSettings("localhost:1", **wrong_one)  # type: ignore[arg-type]
        assert "secret" not in str(refused.value)


def test_numpy_numbers_and_booleans_are_accepted() -> None:
    flexible = Flexible(Waypoint(0, 1.0, 2.0), at_any_frame=np.bool_(True))  # type: ignore[arg-type]
    assert convert.constraint(1, flexible).at_any_frame is True
    waypoint = Waypoint(np.int64(30), np.float32(1.5), np.int32(2), tolerance_m=np.float64(0.5))  # type: ignore[arg-type]
    assert convert.constraint(1, waypoint).waypoint.x == 1.5
    options = SessionOptions(seed=np.uint64(7), denoise_steps=np.int16(4), priority=Priority.HERO)  # type: ignore[arg-type]
    assert convert.open_session(options, [], []).seed == 7
    assert SessionOptions(outputs=["g1_qpos"], frame_format=FrameFormat.F16).outputs == ("g1_qpos",)  # type: ignore[arg-type]
