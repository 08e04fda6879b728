"""Finished rows with their feet in place and their joints on their goals, as the model wants it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_server.runner.row import Row


def corrected(model: Model, rows: Sequence[Row], features: Tensor) -> Tensor:
    """Normalised features (B, G, D) of rows whose histories are equally long, in the world frame, corrected."""
    if not model.sampling.corrects:
        return features
    history = torch.from_numpy(np.stack([row.job.history for row in rows])).to(features.device)
    goals = _world_goals(model, rows, features)
    return correct_window(model.representation, history, features, goals, model.sampling, model.config.patch)


def _world_goals(model: Model, rows: Sequence[Row], features: Tensor) -> tuple[Tensor, Tensor] | None:
    """What is observed at the rows' frames, in the world frame, and the mask; None where no row has goals."""
    if all(row.goals is None for row in rows):
        return None
    none = torch.zeros_like(features[0])
    observed, mask = (
        torch.stack([none if row.goals is None else row.goals[part] for row in rows]) for part in range(2)
    )
    offset = torch.stack([row.translation for row in rows])
    root = model.representation.translate_root(observed[..., :ROOT_WIDTH], offset)
    return torch.cat([root, observed[..., ROOT_WIDTH:]], dim=-1) * mask, mask
