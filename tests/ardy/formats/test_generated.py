"""Generated motion is written to every format that its skeleton has, and read back."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.residuals import residuals
from motiongen_ardy.formats.constraints import RootConstraint, constraint_targets, pose_constraint
from motiongen_ardy.formats.files import MOTION_FORMATS, read_motion, write_motion
from motiongen_ardy.formats.stored import StoredMotion
from motiongen_ardy.model.rollout import RolloutRequest, rollout

GOLDEN = Path(__file__).resolve().parents[2] / "data" / "golden"


def generated(name: str) -> StoredMotion:
    """Two windows of a golden model. Its weights are random, so the poses are wild, but formats must keep them."""
    model = load_checkpoint(GOLDEN / name / "checkpoint")
    config = model.config
    request = RolloutRequest(2 * config.horizon, torch.zeros(config.denoiser.text_dim), seed=1, num_steps=2)
    features = model.representation.denormalize(rollout(model, request))
    return StoredMotion(model.skeleton, model.representation.motion(features), "made up")


@pytest.mark.parametrize("name", ["tiny-core27", "tiny-g134"])
def test_generated_motion_round_trips_through_every_format(tmp_path: Path, name: str) -> None:
    stored = generated(name)
    fitting = [one for one in MOTION_FORMATS if stored.skeleton.name == "g134" or not one.name.startswith("g1")]
    assert len(fitting) == (5 if name == "tiny-g134" else 3)
    for chosen in fitting:
        path = tmp_path / f"motion{chosen.suffix}"
        said = write_motion(path, stored)
        assert path.stat().st_size > 1000
        if chosen.read is None:
            continue
        again = read_motion(path)
        assert (again.skeleton.name, again.motion.fps) == (stored.skeleton.name, stored.motion.fps)
        assert again.motion.num_frames == stored.motion.num_frames
        if chosen.name.startswith("g1"):
            assert any("the hinges cannot do" in line for line in said), "the hinges cannot do most of a random pose"
            torch.testing.assert_close(again.motion.root_positions, stored.motion.root_positions, atol=1e-4, rtol=1e-6)
        else:
            torch.testing.assert_close(again.positions(), stored.positions(), atol=1e-4, rtol=1e-5)


def test_residuals_of_generated_motion_are_the_same_after_writing(tmp_path: Path) -> None:
    stored = generated("tiny-core27")
    asked = [RootConstraint((3,), torch.tensor([[1.0, 2.0]])), pose_constraint(stored.motion, [8])]
    targets = [constraint_targets(stored.skeleton, [one]) for one in asked]
    write_motion(tmp_path / "motion.npz", stored)
    before, after = (
        residuals(motion, targets) for motion in (stored.motion, read_motion(tmp_path / "motion.npz").motion)
    )
    assert before == after
    assert before[0].position_m is not None
    away = (stored.motion.root_positions[3, [0, 2]] - torch.tensor([1.0, 2.0])).norm()
    assert before[0].position_m.worst == pytest.approx(float(away), rel=1e-4)
    assert before[1].position_m is not None
    assert before[1].position_m.worst < 1e-3
