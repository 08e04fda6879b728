"""From denoised tokens to frames: decoded, corrected as the model requires, and laid out for the wire."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.generation import world_tokens_of
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.packed.graphs import GraphedRows
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.tokenizer.explicit import ExplicitBody
from motiongen_ardy.model.tokenizer.model import Tokenizer
from motiongen_server.engine.types import Float32Array, JointRotations, JointTargets, Keyframe
from motiongen_server.runner.frames import wire_rows
from motiongen_server.runner.host_copy import on_host
from motiongen_server.runner.row import Row

Asked = Literal["nothing", "root", "joints"]


class Decoded(NamedTuple):
    """The result of one row. frames: (G, row width); features: (G, D), normalised.

    tokens: (G / 4, 20 + L); None if frames are corrected, as tokens would then stand for frames that nobody was shown.
    """

    frames: Float32Array
    features: Float32Array
    tokens: Float32Array | None


class Decoding:
    """Decodes rows of one model, those with equally long histories together: the causal decoder reads the history.

    With graphs, decoding is replayed as one graph, except for rows with goals for joints: these need varying work.
    """

    def __init__(self, model: Model, codec: Tokenizer | ExplicitBody, graphs: GraphCache | None = None) -> None:
        """codec: the model's own, in the form that serves."""
        self._model = model
        self._codec = codec
        self._replayed = None if graphs is None else GraphedRows(partial(self._decoded, reaches=False), graphs)

    def __call__(self, rows: Sequence[Row]) -> list[Decoded]:
        """The result of each row, in the order of the rows."""
        alike: dict[tuple[int, Asked | None], list[int]] = {}
        for number, row in enumerate(rows):
            asked = None if self._replayed is None or not self._model.sampling.corrects else asked_of(row)
            alike.setdefault((len(row.history), asked), []).append(number)
        found: dict[int, Decoded] = {}
        for (_, asked), numbers in alike.items():
            found.update(zip(numbers, self._together([rows[number] for number in numbers], asked), strict=True))
        return [found[number] for number in range(len(rows))]

    def _together(self, rows: Sequence[Row], asked: Asked | None) -> list[Decoded]:
        histories, horizons = torch.stack([row.history for row in rows]), torch.stack([row.tokens for row in rows])
        given = [torch.cat([histories, horizons], dim=1), torch.stack([row.translation for row in rows])]
        if self._model.sampling.corrects:
            history = torch.from_numpy(np.stack([row.job.history for row in rows]))
            given += [history.to(given[0].device), *_goals(rows)]
        replayed = None if asked == "joints" else self._replayed
        frames, features, *kept = on_host(*(self._decoded(*given) if replayed is None else replayed(*given)))
        tokens = kept[0] if kept else [None] * len(rows)
        return [Decoded(*parts) for parts in zip(frames, features, tokens, strict=True)]

    def _decoded(
        self,
        tokens: Tensor,
        translation: Tensor,
        history: Tensor | None = None,
        observed: Tensor | None = None,
        mask: Tensor | None = None,
        *,
        reaches: bool | None = None,
    ) -> tuple[Tensor, ...]:
        """Wire rows, features and, if they are kept, tokens of the horizons.

        tokens: (B, N, 20 + L), including the history's, in the window's frame; translation: (B, 3) metres from that to
        the world's. history: (B, H, D), given if frames are corrected; observed, mask: (B, G, D), in the window's
        frame, None if no row has goals; reaches: whether there are goals for joints, as for `correct_window`.
        """
        model, layout, patch = self._model, self._model.representation, self._model.config.patch
        tokens = world_tokens_of(model, tokens, translation)
        lengths = torch.full((len(tokens),), tokens.shape[1] * patch, device=tokens.device)
        num_history = tokens.shape[1] - model.config.horizon // patch
        features = self._codec.from_hybrid(tokens, lengths)[:, num_history * patch :]
        if history is None:
            return wire_rows(layout, features), features, tokens[:, num_history:]
        goals = None
        if observed is not None and mask is not None:
            root = layout.translate_root(observed[..., :ROOT_WIDTH], translation)
            goals = torch.cat([root, observed[..., ROOT_WIDTH:]], dim=-1) * mask, mask
        features = correct_window(layout, history, features, goals, model.sampling, patch, reaches=reaches)
        return wire_rows(layout, features), features


def asked_of(row: Row) -> Asked:
    """What kind of goals the row has."""
    if row.goals is None:
        return "nothing"
    of_joints = (JointRotations, JointTargets, Keyframe)
    return "joints" if any(isinstance(one, of_joints) for one in row.job.constraints) else "root"


def _goals(rows: Sequence[Row]) -> list[Tensor]:
    """Observed features (B, G, D) of rows, in the windows' frames, and their mask; empty if no row has goals."""
    known = next((row.goals for row in rows if row.goals is not None), None)
    if known is None:
        return []
    none = torch.zeros_like(known[0])
    return [torch.stack([none if row.goals is None else row.goals[part] for row in rows]) for part in range(2)]
