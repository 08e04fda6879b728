"""Constraints from the wire: when each is to be met, what it is relative to, its weight, and paths."""

from __future__ import annotations

from typing import Any

import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import (
    Asked,
    Code,
    EventRefused,
    Guidance,
    HeadingTarget,
    JointTargets,
    Open,
    Opened,
    Outcome,
    Placement,
    RootPath,
    RootTrajectory,
    SessionKey,
    SetConstraints,
    Unplaced,
    Waypoint,
)
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.clip.request import clip_specs
from motiongen_server.rpc.convert import engine_event, write_update
from motiongen_server.rpc.limits import Limits
from tests.server.engine.fakes import FACTS

KEY = SessionKey(3, 9)
CATALOG = Catalog(FACTS, Limits(), Guidance(1.5, 2.5), "CC0-1.0", text_encoder="hashed-1", history_frames=16)
THERE = motion_pb2.Waypoint(x=1.0, z=2.0)
WAY = motion_pb2.RootPath(positions=[0.0, 1.0, 2.0, 3.0])
LEAD = motion_pb2.RootTrajectory(positions=[0.0, 0.0])
LEAD_OF_TWO = motion_pb2.RootTrajectory(positions=[0.0] * 4)


def way(**fields: float) -> motion_pb2.RootPath:
    return motion_pb2.RootPath(positions=[0, 0], **fields)


def asked(**fields: Any) -> Asked:
    """What the engine is asked for by one constraint."""
    edit = session_pb2.EditConstraints(upsert=[motion_pb2.Constraint(constraint_id=1, **fields)])
    event = engine_event(session_pb2.SessionEvent(event_seq=2, edit_constraints=edit), KEY, 1.0, {}, CATALOG)
    assert isinstance(event, SetConstraints)
    (found,) = event.upsert
    return found


def test_constraint_without_further_terms_arrives_as_a_plain_target() -> None:
    found = asked(frame=40, waypoint=THERE)
    assert found == Waypoint(1, 40, 1.0, 2.0)


def test_every_term_of_a_constraint_arrives() -> None:
    found = asked(frame=40, last_frame=80, frames_from_effect=True, relative_to_character=True, waypoint=THERE)
    assert isinstance(found, Unplaced)
    assert isinstance(found.target, Waypoint)
    assert (found.last_frame, found.frames_from_effect, found.is_relative) == (80, True, True)
    soon = asked(at_any_frame=True, weight=0.5, heading=motion_pb2.HeadingTarget(heading=1.0))
    assert isinstance(soon, Unplaced)
    assert isinstance(soon.target, HeadingTarget)
    assert (soon.at_any_frame, soon.target.weight) == (True, 0.5)


def test_root_path_has_its_own_speed_and_smoothing_or_the_defaults() -> None:
    usual, own = (
        asked(root_path=WAY),
        asked(root_path=motion_pb2.RootPath(positions=[1, 2], speed_mps=2, smoothing_m=0)),
    )
    assert isinstance(usual, Unplaced)
    assert isinstance(usual.target, RootPath)
    assert usual.target.corners.tolist() == [[0.0, 1.0], [2.0, 3.0]]
    assert (usual.target.speed_mps, usual.target.smoothing_m) == (1.2, 0.3)
    assert isinstance(own, Unplaced)
    assert isinstance(own.target, RootPath)
    assert (own.target.speed_mps, own.target.smoothing_m) == (2.0, 0.0)


def test_joint_targets_need_no_waypoint() -> None:
    rig = CATALOG.facts.rig
    assert len(rig.joint_names) == 1
    found = asked(frame=9, joint_targets=motion_pb2.JointTargets(joints=[0], positions=[0, 1, 0]))
    assert isinstance(found, JointTargets)


@pytest.mark.parametrize(
    ("fields", "reason", "field"),
    [
        ({"frame": 40, "last_frame": 39, "waypoint": THERE}, "EMPTY_SPAN", "last_frame"),
        ({"frame": 40, "last_frame": 2**60, "waypoint": THERE}, "FRAME_OUT_OF_RANGE", "last_frame"),
        ({"frame": 2**53, "root_trajectory": LEAD_OF_TWO}, "FRAME_OUT_OF_RANGE", "frame"),
        ({"frame": 40, "last_frame": 50, "root_trajectory": LEAD}, "AMBIGUOUS_FRAMES", "last_frame"),
        ({"last_frame": 50, "root_path": WAY}, "AMBIGUOUS_FRAMES", "last_frame"),
        ({"last_frame": 50, "at_any_frame": True, "waypoint": THERE}, "AMBIGUOUS_FRAMES", "at_any_frame"),
        ({"at_any_frame": True, "root_trajectory": LEAD}, "AMBIGUOUS_FRAMES", "at_any_frame"),
        ({"frame": 7, "at_any_frame": True, "waypoint": THERE}, "AMBIGUOUS_FRAMES", "frame"),
        ({"frame": 7, "root_path": WAY}, "AMBIGUOUS_FRAMES", "frame"),
        ({"frame": 40, "weight": 0.0, "waypoint": THERE}, "WEIGHT_OUT_OF_RANGE", "weight"),
        ({"frame": 40, "weight": 10.5, "waypoint": THERE}, "WEIGHT_OUT_OF_RANGE", "weight"),
        ({"frame": 40, "weight": float("nan"), "waypoint": THERE}, "NOT_FINITE", "weight"),
        ({"root_path": motion_pb2.RootPath()}, "WRONG_LENGTH", "root_path.positions"),
        ({"root_path": motion_pb2.RootPath(positions=[1, 2, 3])}, "WRONG_LENGTH", "root_path.positions"),
        ({"root_path": motion_pb2.RootPath(positions=[0] * 514)}, "WRONG_LENGTH", "root_path.positions"),
        ({"root_path": motion_pb2.RootPath(positions=[1e9, 0])}, "COORDINATE_OUT_OF_RANGE", "root_path.positions"),
        (
            {"root_path": way(speed_mps=0)},
            "SPEED_OUT_OF_RANGE",
            "root_path.speed_mps",
        ),
        (
            {"root_path": way(speed_mps=99)},
            "SPEED_OUT_OF_RANGE",
            "root_path.speed_mps",
        ),
        (
            {"root_path": way(smoothing_m=-1)},
            "SMOOTHING_OUT_OF_RANGE",
            "root_path.smoothing_m",
        ),
        (
            {"root_path": way(smoothing_m=float("inf"))},
            "NOT_FINITE",
            "root_path.smoothing_m",
        ),
        ({"frame": 4, "joint_targets": motion_pb2.JointTargets()}, "INVALID_JOINTS", "joint_targets.joints"),
    ],
)
def test_invalid_constraint_is_refused_with_reason_and_field(fields: dict[str, Any], reason: str, field: str) -> None:
    with pytest.raises(EventRefused) as refused:
        asked(**fields)
    assert (refused.value.reason, refused.value.field) == (reason, f"edit_constraints.upsert[0].{field}")
    assert refused.value.allowed


def test_placements_are_reported_in_outcome_and_opened() -> None:
    placement = Placement(5, 100, 170, 130, 100, 1.0, 2.0, 0.5)
    update = session_pb2.SessionUpdate()
    write_update(update, Outcome(KEY, 4, Code.OK, 100, placements=(placement,)))
    (told,) = update.outcome.placements
    assert (told.constraint_id, told.first_frame, told.last_frame, told.arrival_frame) == (5, 100, 170, 130)
    assert (told.anchor_frame, told.anchor_x, told.anchor_z, told.anchor_heading) == (100, 1.0, 2.0, 0.5)
    write_update(update, Opened(KEY, 1, 0, 40, 4, 4, "m", "r", 20, placements=(placement,)))
    assert list(update.opened.placements) == [told]


def clip(**fields: Any) -> list[Any]:
    opening = session_pb2.OpenSession(constraints=[motion_pb2.Constraint(constraint_id=1, **fields)])
    return list(clip_specs(service_pb2.GenerateClipRequest(open=opening, frame_count=60), 1, {}, 1.0, CATALOG))


def test_clip_accepts_only_constraints_up_to_its_last_frame() -> None:
    for fields in (
        {"at_any_frame": True, "waypoint": THERE},
        {"root_path": WAY},
        {"last_frame": 59, "waypoint": THERE},
    ):
        assert clip(**fields)
    with pytest.raises(EventRefused, match="last frame is 60") as refused:
        clip(last_frame=60, waypoint=THERE)
    assert refused.value.reason == "CONSTRAINT_OUTSIDE_CLIP"


def test_open_accepts_a_constraint_at_any_frame() -> None:
    opening = session_pb2.OpenSession(
        constraints=[motion_pb2.Constraint(constraint_id=1, at_any_frame=True, waypoint=THERE)]
    )
    event = engine_event(session_pb2.SessionEvent(event_seq=1, open=opening), KEY, 1.0, {}, CATALOG)
    assert isinstance(event, Open)
    assert isinstance(event.spec.constraints[0], Unplaced)
    assert not isinstance(event.spec.constraints[0].target, RootTrajectory)
