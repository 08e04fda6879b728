"""Speeds beyond those a model was trained for: accepted, with a warning that gives the trained speed."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_compliance.messages import edit_constraints, waypoint
from motiongen_server.engine.types import Direction, Gait, Guidance, RootPath, RootTrajectory, SessionKey, SetVelocity
from motiongen_server.rpc.abilities import Abilities, GaitText
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event, warnings_of
from motiongen_server.rpc.convert.speeds import speeds_of
from motiongen_server.rpc.limits import Limits
from tests.server.engine.fakes import FACTS

KEY = SessionKey(1, 1)
FPS = FACTS.fps
GAITS = (
    GaitText("walk", "walk", 0.0, Direction.FORWARD, 2.0),
    GaitText("run", "run", 2.0, Direction.FORWARD, 3.0),
    GaitText("back", "back", 0.2, Direction.BACKWARD, 1.5),
)


def _catalog(abilities: Abilities) -> Catalog:
    gaits = [Gait(each.name, each.text, each.from_mps, each.direction, np.zeros(2, np.float32)) for each in GAITS]
    return Catalog(
        FACTS, Limits(), Guidance(2, 2), "CC0-1.0",
        text_encoder="length-1", history_frames=16, gaits=gaits, abilities=abilities,
    )  # fmt: skip


CATALOG = _catalog(Abilities(gaits=GAITS))


def _velocity(x: float, z: float, heading: float | None = None) -> session_pb2.SessionEvent:
    velocity = session_pb2.SetVelocity(x=x, z=z, hold_frames=9)
    if heading is not None:
        velocity.heading = heading
    return session_pb2.SessionEvent(set_velocity=velocity)


def _straight(constraint_id: int, mps: float) -> motion_pb2.Constraint:
    ground = np.stack([np.zeros(3 * FPS), mps / FPS * np.arange(3 * FPS)], axis=1)
    target = motion_pb2.RootTrajectory(positions=ground.ravel().tolist())
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=9, root_trajectory=target)


def _told(event: session_pb2.SessionEvent, catalog: Catalog = CATALOG) -> tuple[str, ...]:
    warnings = warnings_of(event, engine_event(event, KEY, 0.0, {}, catalog), catalog)
    assert all(warning.reason == "UNTRAINED_SPEED" for warning in warnings)
    return tuple(warning.message for warning in warnings)


FORWARD = ("fake steps forward at up to 3 m/s; higher speeds are accepted, but feet may glide",)
BACKWARD = ("fake steps backward at up to 1.5 m/s; higher speeds are accepted, but feet may glide",)


@pytest.mark.parametrize(
    ("event", "told"),
    [
        (_velocity(0, 3), ()),
        (_velocity(2.5, 2.5), FORWARD),  # faces where it goes
        (_velocity(0, -1.5, 0), ()),
        (_velocity(0, -1.6, 0), BACKWARD),
        (_velocity(1.6, 0, -math.pi / 2), BACKWARD),
        (_velocity(1.6, 0, 5 * math.pi / 2), ()),  # forward, after a full turn
        (_velocity(9, 0, 0), ()),  # no speed is claimed sideways
    ],
)
def test_velocity_is_warned_about_by_its_speed_relative_to_the_heading(
    event: session_pb2.SessionEvent, told: tuple[str, ...]
) -> None:
    assert _told(event) == told


def test_first_path_that_is_too_fast_is_named() -> None:
    event = edit_constraints(waypoint(9), _straight(2, 1.0), _straight(3, 4.0), _straight(4, 4.0))
    (warning,) = warnings_of(event, engine_event(event, KEY, 0.0, {}, CATALOG), CATALOG)
    assert (warning.reason, warning.field) == ("UNTRAINED_SPEED", "edit_constraints.upsert[2]")


def test_without_claimed_speeds_there_is_no_warning() -> None:
    assert _told(_velocity(0, -9, 0), _catalog(Abilities())) == ()
    walk = GaitText("walk", "walk", 0.0, Direction.FORWARD)
    assert _told(_velocity(0, -9, 0), _catalog(Abilities(gaits=(walk,)))) == ()


def test_model_that_only_stands_warns_about_every_speed() -> None:
    stand = GaitText("stand", "stand", 0.0, Direction.FORWARD, 0.0)
    catalog = _catalog(Abilities(gaits=(stand,)))
    assert len(_told(_velocity(0, 0.5), catalog)) == 1
    assert _told(_velocity(0, 0), catalog) == ()


def test_catalogue_gives_the_speeds_of_locomotion_presets() -> None:
    (model,) = CATALOG.response("").models
    assert [preset.to_speed_mps for preset in model.locomotion_presets] == [2.0, 3.0, 1.5]
    (model,) = _catalog(Abilities()).response("").models
    assert [preset.to_speed_mps for preset in model.locomotion_presets] == [0.0, 0.0, 0.0]


def _trajectory(seconds: float, facing: float | None, *, mps: float = 2.0) -> Mapping[Direction, float]:
    frames = np.arange(round(seconds * FPS)) / FPS
    xz = np.stack([np.zeros_like(frames), mps * frames], axis=1).astype(np.float32)
    heading = None if facing is None else np.full(len(frames), facing, np.float32)
    return speeds_of(RootTrajectory(1, 0, xz, heading), FPS)


def test_trajectory_has_a_speed_for_each_direction_it_faces() -> None:
    assert _trajectory(2, None) == {Direction.FORWARD: pytest.approx(2.0, rel=1e-3)}
    assert _trajectory(2, math.pi) == {Direction.BACKWARD: pytest.approx(2.0, rel=1e-3)}
    assert _trajectory(2, -math.pi / 2) == {Direction.LEFT: pytest.approx(2.0, rel=1e-3)}
    assert _trajectory(2, 3 * math.pi / 2) == {Direction.LEFT: pytest.approx(2.0, rel=1e-3)}
    assert _trajectory(0.4, None) == {}, "too short for two steps"


def test_swaying_root_counts_with_the_speed_of_its_path() -> None:
    frames = np.arange(4 * FPS) / FPS
    sway = 0.03 * np.sin(2 * math.pi * 4 * frames)
    xz = np.stack([sway, 1.0 * frames], axis=1).astype(np.float32)
    assert speeds_of(RootTrajectory(1, 0, xz), FPS)[Direction.FORWARD] < 1.02


def test_path_and_velocity_have_the_speed_they_state() -> None:
    assert speeds_of(RootPath(1, np.ones((2, 2), np.float32), 1.7, 0.1), FPS) == {Direction.FORWARD: 1.7}
    assert speeds_of(SetVelocity(KEY, 1, 0.0, 3.0, 4.0, None, 9), FPS) == {Direction.FORWARD: 5.0}


def test_trajectory_at_one_frame_a_second_has_a_speed() -> None:
    path = RootTrajectory(1, 0, np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 3.0]], np.float32))
    assert speeds_of(path, 1) == {Direction.FORWARD: 2.0}
