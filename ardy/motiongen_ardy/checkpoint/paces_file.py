"""PromptPaces <-> `prompt_paces.safetensors` of a checkpoint folder."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from motiongen_ardy.checkpoint.files import CheckpointError, TensorFile
from motiongen_ardy.core.files import written_whole
from motiongen_ardy.model.sampling.paces import PromptPaces

PACES_FILE = "prompt_paces.safetensors"
MAX_ROWS = 4096
# The dimensions of each tensor, as letters that must agree within the file. W is the width of the model's texts.
_SHAPES = {
    "mean": "W",
    "directions": "NW",
    "speeds": "N2",
    "threshold": "",
    "gaits": "KW",
    "from_mps": "K",
    "quarters": "K",
}


def read_paces(path: Path, text_dim: int) -> PromptPaces:
    """The paces in a file written by `write_paces`, for texts of text_dim numbers.

    Raises CheckpointError for any other file, and for one that is too large or holds numbers outside their range.
    """
    file = TensorFile(path)
    if file.entries.keys() != _SHAPES.keys():
        raise CheckpointError(f"{path} holds {', '.join(sorted(file.entries))[:200]}; give {', '.join(_SHAPES)}")
    file.require_weights(_SHAPES)
    sizes = {"W": text_dim, "2": 2}
    for name, letters in _SHAPES.items():
        shape = file.entries[name].shape
        fits = len(shape) == len(letters) and all(
            0 < size <= max(MAX_ROWS, text_dim) and sizes.setdefault(letter, size) == size
            for letter, size in zip(letters, shape, strict=True)
        )
        if not fits:
            known = ", ".join(f"{letter} = {size}" for letter, size in sizes.items() if letter != "2")
            raise CheckpointError(f"{path}: {name} has the shape {shape}; give ({', '.join(letters)}) with {known}")
    tensors = file.read(dict.fromkeys(_SHAPES, torch.float32))
    if broken := [name for name, tensor in tensors.items() if not bool(tensor.isfinite().all())]:
        raise CheckpointError(f"{path}: {', '.join(sorted(broken))} hold NaN or infinite numbers")
    slow, fast = tensors["speeds"].unbind(dim=1)
    if bool((slow < 0).any() | (fast < slow).any()):
        raise CheckpointError(f"{path}: speeds must be two numbers from 0 on, the second not below the first")
    quarters = tensors["quarters"]
    if not bool(((quarters >= 0) & (quarters <= 3) & (quarters == quarters.round())).all()):
        raise CheckpointError(f"{path}: quarters must be whole numbers from 0 to 3")
    threshold = float(tensors["threshold"])
    return PromptPaces(**{name: threshold if name == "threshold" else tensors[name] for name in _SHAPES})


def write_paces(path: Path, paces: PromptPaces) -> None:
    """Write the file, atomically replacing any earlier one.

    Texts are stored with 11 bits of precision, more than is needed to tell them apart.
    """
    from safetensors.torch import save_file

    tensors: dict[str, Tensor] = {name: torch.as_tensor(getattr(paces, name)).float() for name in _SHAPES}
    tensors["directions"] = tensors["directions"].half()
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as partial:
        save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, partial)
