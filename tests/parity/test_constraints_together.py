"""Constraints that are legal one by one are legal together: they close no session, and each is met as if alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.model.model import Model
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.residuals import Residual
from motiongen_server.engine.types import (
    Chunk,
    Closed,
    Constraint,
    Guidance,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Open,
    Output,
    Priority,
    RootTrajectory,
    SessionKey,
    SessionSpec,
    SetVelocity,
    Span,
    Waypoint,
)
from motiongen_server.runner import TorchRunner
from tests.server.engine.fakes import FakeClock

HAND = 17
NUM_FRAMES = 100


@pytest.fixture(scope="module")
def mini() -> Model:
    return load_checkpoint(model_folder("motiongen-mini"))


@dataclass
class Played:
    """What the sessions streamed: frame rows by session handle, and why any session was closed."""

    rows: dict[int, list[np.ndarray]] = field(default_factory=dict)
    closed: list[str] = field(default_factory=list)

    def take(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, Closed):
                self.closed.append(f"{output.session}: {output.message}")
            elif isinstance(output, Chunk):
                rows = self.rows.setdefault(output.session.handle, [])
                del rows[output.first_frame :]
                rows.extend(output.rows)


def played(
    model: Model, asked: Sequence[tuple[Constraint, ...]], led: frozenset[int] = frozenset(), stride: int = 1
) -> Played:
    """What sessions with these constraints stream. led: the sessions that a velocity steers as well."""
    options = replace(model.sampling, plan=replace(model.sampling.plan, stride_frames=stride))
    model.sampling, before = options, model.sampling
    clock, found = FakeClock(), Played()
    try:
        engine = Engine(TorchRunner(model, "mini"), clock, found.take, EngineConfig(playback_rate=1e6))
        for number, constraints in enumerate(asked):
            spec = SessionSpec(
                SessionKey(1, number),
                seed=number,
                model_id="mini",
                priority=Priority.NEAR,
                lookahead=NUM_FRAMES + 60,
                denoise_steps=2,
                guidance=Guidance(1.0, 1.0),
                constraints=constraints,
            )
            engine.submit(Open(spec, 1, clock.now()))
            if number in led:
                engine.submit(SetVelocity(spec.session, 2, clock.now(), 0.3, 1.0, None, 60))
        for _ in range(400):
            engine.step()
            clock.advance(0.01)
            if (len(found.rows) == len(asked) and min(map(len, found.rows.values())) >= NUM_FRAMES) or found.closed:
                break
    finally:
        model.sampling = before
    return found


def hand(frame: int, place: tuple[float, float, float], number: int = 1) -> JointTargets:
    return JointTargets(number, frame, (HAND,), np.array([place], np.float32))


NEAR = hand(60, (0.3, 1.2, 1.2))
WITH_ROOT = JointTargets(2, 80, (0, HAND), np.array([[0.0, 0.9, 1.0], [0.3, 1.2, 1.2]], np.float32))


@pytest.mark.parametrize(
    "other",
    [Waypoint(2, 80, 0.5, 2.0), Waypoint(2, 61, 0.5, 1.3), Waypoint(2, 80, -1.5, 1.0), WITH_ROOT],
    ids=["beyond", "close behind", "aside", "a hand with its root"],
)
@pytest.mark.parametrize("stride", [1, 5])
def test_hand_target_without_a_root_is_met_on_the_way_to_another_constraint(
    mini: Model, other: Constraint, stride: int
) -> None:
    found = played(mini, [(NEAR, other)], stride=stride)
    assert not found.closed
    posed = Posed(TorchRunner(mini, "mini").facts.rig, np.stack(found.rows[0]))
    for asked, most_m in ((NEAR, 0.06), (other, 0.03)):
        residual = Residual()
        residual.add(asked, asked.first_frame, posed.part(asked.first_frame, asked.first_frame + 1))
        assert residual.position_m is not None
        assert residual.position_m.worst < most_m
    root = posed.root()[:, [0, 2]]
    assert np.hypot(*np.diff(root, axis=0).T).max() * mini.config.fps < 3.0


def test_hand_target_under_a_velocity_is_met_without_a_jump_of_the_root(mini: Model) -> None:
    asked = hand(23, (0.3, 1.2, 1.2)), hand(50, (2.0, 1.2, 1.4), 2)
    found = played(mini, [asked], led=frozenset([0]), stride=5)
    assert not found.closed
    posed = Posed(TorchRunner(mini, "mini").facts.rig, np.stack(found.rows[0]))
    residual = Residual()
    residual.add(asked[0], 23, posed.part(23, 24))
    assert residual.position_m is not None
    assert residual.position_m.worst < 0.06
    assert np.hypot(*np.diff(posed.root()[:, [0, 2]], axis=0).T).max() * mini.config.fps < 3.0


def random_constraint(number: int, random: np.random.Generator, mini: Model) -> Constraint:
    """A constraint of any kind, within a few metres and within the first nine seconds."""
    frame = int(random.integers(0, 180))
    x, z = random.uniform(-2.0, 2.0, 2).tolist()
    heading = float(random.uniform(-3.0, 3.0)) if random.random() < 0.5 else None
    span = Span(frame, frame + 60, is_led=bool(random.random() < 0.5)) if random.random() < 0.2 else None
    weight = float(random.choice([1.0, 1.0, 2.0]))
    joints = tuple(sorted(random.choice(np.arange(1, mini.skeleton.num_joints), 2, replace=False).tolist()))
    places = np.stack([[x, 1.0, z] + 0.3 * random.standard_normal(3) for _ in range(2)]).astype(np.float32)
    match int(random.integers(0, 7)):
        case 0:
            return Waypoint(number, frame, x, z, heading, weight=weight, span=span)
        case 1:
            return HeadingTarget(number, frame, heading or 0.0, weight=weight, span=span)
        case 2:
            return JointTargets(
                number, frame, (0, *joints), np.concatenate([[[x, 0.9, z]], places]).astype(np.float32), weight=weight
            )
        case 3:
            count = int(random.integers(1, 60))
            way = np.linspace((0.0, 0.0), (x, z), count, dtype=np.float32).reshape(count, 2)
            return RootTrajectory(number, frame, way, weight=weight)
        case 4:
            pose = mini.skeleton.neutral_joints + np.array([x, 0.9, z])
            return Keyframe(number, frame, pose.astype(np.float32), weight=weight)
        case 5:
            return JointRotations(number, frame, joints, np.tile(np.eye(3, dtype=np.float32), (2, 1, 1)), weight=weight)
    return JointTargets(number, frame, joints, places, weight=weight, span=span)


@pytest.mark.parametrize("stride", [1, 5])
@pytest.mark.parametrize("seed", range(2))
def test_legal_constraints_never_close_a_session(mini: Model, seed: int, stride: int) -> None:
    random = np.random.default_rng(seed)
    asked = [
        tuple(random_constraint(number, random, mini) for number in range(1, int(random.integers(2, 8))))
        for _ in range(16)
    ]
    found = played(mini, asked, frozenset(range(0, 16, 3)), stride)
    assert not found.closed
    assert len(found.rows) == len(asked)
    assert all(np.isfinite(np.stack(rows)).all() for rows in found.rows.values())
