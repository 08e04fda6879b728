"""The built-in model meets every kind of goal, whichever frame of a window it falls on."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.rotation import rotation_vector, rotation_y
from motiongen_ardy.evaluate.sampler import Sampler, Sampling
from motiongen_ardy.evaluate.take import Result, Take
from motiongen_ardy.text import load_text_encoder

PROMPT = "a person walks forward"
WINDOW = 40
# Frames of the second window: its first and second, one in its middle, and its last.
PHASES = {"first": WINDOW, "second": WINDOW + 1, "middle": WINDOW + 20, "last": 2 * WINDOW - 1}
NEAR_M, NEAR_RAD = 0.02, 0.1

Ask = Callable[[Targets, int, Tensor, Tensor], None]


def _joints(name: str) -> Ask:
    def ask(targets: Targets, frame: int, pose: Tensor, _: Tensor) -> None:
        joints = [0, targets.skeleton.index(name)]
        targets.add_joints(frame, joints, pose[joints])

    return ask


KINDS: dict[str, Ask] = {
    "waypoint": lambda targets, frame, _, own: targets.add_waypoints([frame], own[None] + 0.3),
    "waypoint with heading": lambda targets, frame, _, own: targets.add_waypoints(
        [frame], own[None] + 0.3, torch.tensor([0.5])
    ),
    "heading": lambda targets, frame, *_: targets.add_heading([frame], torch.tensor([math.pi / 4])),
    "head rotation": lambda targets, frame, *_: targets.add_rotations(
        frame, [targets.skeleton.index("Head")], rotation_y(torch.tensor(0.5))[None]
    ),
    "keyframe": lambda targets, frame, pose, _: targets.add_keyframes([frame], pose[None]),
    "hand": _joints("RightHand"),
    "foot": _joints("LeftFoot"),
}


@pytest.fixture(scope="module")
def sampler() -> Sampler:
    model = load_checkpoint(model_folder("motiongen-mini"))
    return Sampler(model, load_text_encoder("static", model.config.denoiser.text_dim), Sampling(4))


@pytest.fixture(scope="module")
def results(sampler: Sampler) -> dict[tuple[str, str], Result]:
    """A walk for each kind and phase; its goal is a pose of another seed's walk, moved to where this one would be."""
    takes = [Take("plain", seed, max(PHASES.values()) + 1, ((0, PROMPT),)) for seed in (1, 2)]
    own, other = sampler.run(takes)
    asked = {}
    for kind, ask in KINDS.items():
        for phase, frame in PHASES.items():
            shift = (own.positions[frame, 0] - other.positions[frame, 0]) * torch.tensor([1.0, 0.0, 1.0])
            targets = Targets(sampler.model.skeleton)
            ask(targets, frame, other.positions[frame] + shift, own.root[frame])
            asked[kind, phase] = Take(kind, 1, frame + 1, ((0, PROMPT),), targets=targets)
    return dict(zip(asked, sampler.run(list(asked.values())), strict=True))


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("kind", KINDS)
def test_a_goal_is_met_at_any_frame_of_the_window(
    sampler: Sampler, results: dict[tuple[str, str], Result], kind: str, phase: str
) -> None:
    result, frame, skeleton = results[kind, phase], PHASES[phase], sampler.model.skeleton
    targets = result.take.targets
    assert targets is not None
    if frame in targets.ground:
        assert (result.root[frame] - torch.from_numpy(targets.ground[frame])).norm() < NEAR_M
    if frame in targets.heading:
        cosine, sine = targets.heading[frame].tolist()
        off = math.remainder(math.atan2(sine, cosine) - float(result.facing(skeleton)[frame]), math.tau)
        assert abs(off) < NEAR_RAD
    for (_, joint), place in targets.positions.items():
        assert (result.positions[frame, joint] - torch.from_numpy(place)).norm() < NEAR_M
    for (_, joint), turn in targets.rotations.items():
        assert rotation_vector(torch.from_numpy(turn).T @ result.rotations[frame, joint]).norm() < NEAR_RAD
