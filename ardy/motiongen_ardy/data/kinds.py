"""The quality of a set by kind of clip, captured and derived, to compare the two."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from rich.markup import escape
from rich.table import Table

from motiongen_ardy.data.dataset import Clip, MotionDataset
from motiongen_ardy.data.quality import Quality, quality

MIN_FRAMES = 4
DERIVED_FLAG = "derived-"


def kind_of(clip: Clip) -> str:
    """The kind of a clip: its content if captured, how it was made if derived."""
    made = [flag.removeprefix(DERIVED_FLAG) for flag in clip.flags if flag.startswith(DERIVED_FLAG)]
    if made:
        return f"derived: {made[0]}"
    return f"derived: {clip.content}" if clip.derived_from else clip.content


def by_kind(dataset: MotionDataset) -> dict[str, list[tuple[Clip, Quality]]]:
    """All clips of at least MIN_FRAMES frames with their quality, by kind; captured kinds come first."""
    kinds: dict[str, list[tuple[Clip, Quality]]] = defaultdict(list)
    for clip in dataset.clips:
        if clip.num_frames >= MIN_FRAMES:
            quaternions, root = clip.local_rotations.double().numpy(), clip.root_positions.double().numpy()
            kinds[kind_of(clip)].append((clip, quality(dataset.skeleton, quaternions, root, dataset.fps)))
    return dict(sorted(kinds.items(), key=lambda entry: (entry[0].startswith("derived"), entry[0])))


def kinds_table(dataset: MotionDataset) -> Table:
    """One row for each kind: median / 95th percentile over its clips."""
    table = Table(title="by kind: median / 95th percentile over clips; speeds m/s, accelerations m/s2, heights m")
    table.add_column("kind")
    for column in ("clips", "hours", "skate", "slowest foot / root", "acceleration", "knee deg", "lowest", "lifted"):
        table.add_column(column, justify="right")
    columns = (("skate_m_s", 3), ("slowest_ratio", 3), ("acceleration", 0), ("knee_deg", 0), ("lowest_m", 3))
    for kind, entries in by_kind(dataset).items():
        cells = []
        for name, digits in (*columns, ("lifted_m", 3)):
            values = [getattr(figures, name) for _, figures in entries]
            cells.append(f"{np.median(values):.{digits}f} / {np.quantile(values, 0.95):.{digits}f}")
        hours = sum(clip.num_frames for clip, _ in entries) / dataset.fps / 3600
        table.add_row(escape(kind), str(len(entries)), f"{hours:.3f}", *cells)
    return table
