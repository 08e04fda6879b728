"""Makes a runner from a model's name."""

from __future__ import annotations

import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder, read_model_card
from motiongen_ardy.model.packed.cuda_graphs import CudaGraphRecorder
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_server.runner.precision import choose_precision
from motiongen_server.runner.torch_runner import TorchRunner


def load_runner(
    model: str, device: str = "cpu", default_steps: int = 4, precision: str = "float32", cuda_graphs: bool = False
) -> TorchRunner:
    """A runner for a built-in model's name or a checkpoint folder.

    precision: of the denoiser's layers: float32, bfloat16 or auto, as for `choose_precision`. cuda_graphs: whether work
    is replayed as graphs if the device is a GPU. Raises UnknownModel; CheckpointError, ConfigError or StatsError for a
    folder that is not a sound checkpoint; ValueError for another precision.
    """
    folder = model_folder(model)
    loaded = load_checkpoint(folder, device)
    model_id = read_model_card(folder).model_id
    kind, graphs = choose_precision(precision, device), graphs_for(device) if cuda_graphs else None
    return TorchRunner(loaded, model_id, default_steps, kind, owns_model=True, graphs=graphs)


def graphs_for(device: str) -> GraphCache | None:
    """An empty graph cache for one runner on that device; None if the device has no graphs."""
    return GraphCache(CudaGraphRecorder(torch.device(device))) if torch.device(device).type == "cuda" else None
