"""Cut: what a character that is put elsewhere goes on from, in place of the frames before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_server.engine.session.timeline import Timeline, TokenRun
from motiongen_server.engine.types import Float32Array, ModelFacts, StartPose


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """start_pose: where it stands. rows, features: of the frames that it goes on from, if not from a stand."""

    start_pose: StartPose
    rows: Float32Array | None = None
    features: Float32Array | None = None

    def timeline_at(self, frame: int, facts: ModelFacts) -> Timeline:
        """What is held before a window that begins with the cut at a frame."""
        rows, features = self.rows, self.features
        if rows is None or features is None:
            rows = np.empty((0, facts.row_width), np.float32)
            features = np.empty((0, facts.feature_dim), np.float32)
        run = TokenRun(frame, np.empty((0, facts.token_width), np.float32), facts.patch)
        first = frame - len(rows)
        return Timeline(first, rows, features, run, motion_from=first)
