"""Frame rows as sent to clients are converted back to the features that they were made of."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_server.runner import TorchRunner
from motiongen_server.runner.frames import wire_rows
from tests.conftest import ROOT


@pytest.mark.parametrize("name", ["tiny-core27", "tiny-g134"])
def test_features_of_rows_are_those_they_were_made_of(name: str) -> None:
    model = load_checkpoint(ROOT / "tests" / "data" / "golden" / name / "checkpoint")
    layout, joints = model.representation, model.skeleton.num_joints
    numbers = torch.Generator().manual_seed(5)
    quaternions = torch.nn.functional.normalize(torch.randn(1, 12, joints, 4, generator=numbers), dim=-1)
    root = torch.randn(1, 12, 3, generator=numbers)
    features = layout.normalize(layout.features(quaternion_to_matrix(quaternions), root))
    rows = wire_rows(layout, features)[0].numpy()
    found = TorchRunner(model, name).features(np.ascontiguousarray(rows))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, features[0].numpy(), atol=2e-2, rtol=1e-3)
