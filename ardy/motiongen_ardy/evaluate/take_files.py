"""Writes takes of an evaluation as NPZ files, from which `motiongen gallery --takes` makes a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.evaluate.context import Exhibit

FORMAT = "motiongen-evaluated-take-1"


def write_takes(exhibits: Mapping[str, Sequence[Exhibit]], layout: Representation, folder: Path, steps: int) -> int:
    """Write the takes of each part of the evaluation. Returns how many.

    Arrays: positions_m (T, J, 3), contacts (T, 4), goals (K, 3) as frame, x, z, path_m (K, 2), joint_names (J),
    parents (J), frame_rate_hz, title, part, format. World coordinates, metres.
    """
    folder.mkdir(parents=True, exist_ok=True)
    count = 0
    for part, shown in exhibits.items():
        for number, exhibit in enumerate(shown):
            name = f"{re.sub(r'[^a-z0-9]+', '-', part.lower())}-{number:02d}-{steps}-steps.npz"
            with (folder / name).open("wb") as file:
                np.savez_compressed(
                    file,
                    format=FORMAT,
                    part=f"{part}, {steps} steps",
                    title=exhibit.title,
                    positions_m=exhibit.result.positions.numpy().astype(np.float32),
                    contacts=(exhibit.result.features[:, layout.contact_block] > 0.5).numpy(),
                    goals=np.array(exhibit.goals, np.float64).reshape(-1, 3),
                    path_m=np.zeros((0, 2)) if exhibit.path is None else np.asarray(exhibit.path)[:, :2],
                    joint_names=np.array(layout.skeleton.joint_names),
                    parents=np.array(layout.skeleton.parents),
                    frame_rate_hz=layout.fps,
                )
            count += 1
    return count
