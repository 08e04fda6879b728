"""Golden vectors: every folder of `tests/data/golden` with a checkpoint is one model to test."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.window import Window

GOLDEN = Path(__file__).resolve().parents[1] / "data" / "golden"
MODELS = tuple(sorted(folder.parent.name for folder in GOLDEN.glob("*/checkpoint")))
MOTION_NAMES = ("motion", "posed_joints")
MOTION_TOLERANCE = 1e-4
OTHER_TOLERANCE = 2e-5


@dataclass(frozen=True)
class Vectors:
    """The arrays of one golden file; README.md beside the files says how they are named and compared."""

    arrays: dict[str, np.ndarray]
    gaps: dict[str, float]

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def __getitem__(self, name: str) -> Tensor:
        return torch.from_numpy(self.arrays[name])

    def get(self, name: str) -> Tensor | None:
        """The array, or None if the file has none of that name."""
        return self[name] if name in self.arrays else None

    @property
    def cases(self) -> list[str]:
        """The cases in a file with several; they differ between models."""
        return sorted({name.split(".")[0] for name in self.arrays})

    def number(self, name: str) -> int:
        """A whole number that is stored as an array without dimensions."""
        return int(self.arrays[name])

    def window(self, case: str = "") -> Window:
        """The window that a denoiser vector was computed for."""
        return Window(
            history_len=self[f"{case}in.history_len"],
            generation_len=self[f"{case}in.generation_len"],
            num_frames=4 * self.arrays[f"{case}in.x"].shape[1],
            text=self[f"{case}in.text_feat"],
            heading=self[f"{case}in.first_heading_angle"],
            observed=self.get(f"{case}in.observed_motion"),
            mask=self.get(f"{case}in.motion_mask"),
        )

    def reference(self, name: str) -> tuple[Tensor, float]:
        """The array to compare with (double precision where there is one) and the largest difference allowed."""
        precise = f".{name}".replace(".out.", ".out64.").replace(".mid.", ".mid64.")[1:]
        if precise != name and precise in self.arrays:
            expected = self[precise]
            return expected, 4 * self.gaps[precise] + 2e-6 * float(expected.abs().max())
        motion = any(word in name for word in MOTION_NAMES)
        return self[name].double(), MOTION_TOLERANCE if motion else OTHER_TOLERANCE

    def check(self, name: str, actual: Tensor, where: Tensor | None = None) -> None:
        """Fail unless `actual` is the golden array within its tolerance; `where` (bool) limits what is compared."""
        expected, allowed = self.reference(name)
        assert actual.shape == expected.shape, f"{name}: shape {tuple(actual.shape)}, expected {tuple(expected.shape)}"
        error = (actual.detach().double() - expected).abs()
        if where is not None:
            error = error[where]
        largest = float(error.max()) if error.numel() else 0.0
        assert largest <= allowed, f"{name}: off by {largest:.3g}, allowed {allowed:.3g}"

    def check_equal(self, name: str, actual: Tensor) -> None:
        """Fail unless `actual` holds exactly the golden values (masks, indices)."""
        expected = self[name]
        assert actual.shape == expected.shape, f"{name}: shape {tuple(actual.shape)}, expected {tuple(expected.shape)}"
        assert torch.equal(actual.to(expected.dtype), expected), f"{name} differs"


@dataclass(frozen=True)
class GoldenModel:
    """A tiny model with its vectors."""

    name: str
    model: Model

    @property
    def folder(self) -> Path:
        return GOLDEN / self.name

    def vectors(self, file: str) -> Vectors:
        """The vectors of `vectors/<file>.npz`."""
        return read_vectors(self.name, file)


def read_vectors(folder: str, file: str) -> Vectors:
    with np.load(GOLDEN / folder / "vectors" / f"{file}.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    return Vectors(arrays, json.loads((GOLDEN / folder / "gaps.json").read_text()).get(file, {}))


@pytest.fixture(scope="session", params=MODELS)
def golden(request: pytest.FixtureRequest) -> GoldenModel:
    """Each golden model in turn."""
    return GoldenModel(request.param, load_checkpoint(GOLDEN / request.param / "checkpoint"))


@pytest.fixture(scope="session")
def common_vectors() -> Callable[[str], Vectors]:
    """Reads golden files that need no model: rotations, fsq, diffusion."""
    return lambda file: read_vectors("common", file)
