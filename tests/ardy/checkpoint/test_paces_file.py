"""The file of prompt paces: round trip, and the contents that are refused."""

from __future__ import annotations

import shutil
from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch
import yaml
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, save_checkpoint
from motiongen_ardy.checkpoint.files import CheckpointError
from motiongen_ardy.checkpoint.paces_file import PACES_FILE, read_paces, write_paces
from motiongen_ardy.checkpoint.sampling_file import SAMPLING_FILE
from motiongen_ardy.model.sampling.paces import PromptPaces

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"
WIDTH = 32


def paces(width: int = WIDTH) -> PromptPaces:
    return PromptPaces(
        mean=torch.full((width,), 0.1),
        directions=torch.nn.functional.normalize(torch.arange(3.0 * width).reshape(3, width).sin(), dim=1),
        speeds=torch.tensor([[0.0, 0.1], [0.8, 1.6], [2.4, 3.8]]),
        threshold=0.5,
        gaits=torch.arange(2.0 * width).reshape(2, width),
        from_mps=torch.tensor([0.0, 0.15]),
        quarters=torch.tensor([0.0, 2.0]),
    )


def test_written_paces_are_read_back(tmp_path: Path) -> None:
    written = paces()
    write_paces(tmp_path / PACES_FILE, written)
    read = read_paces(tmp_path / PACES_FILE, WIDTH)
    for one in fields(PromptPaces):
        there, here = (torch.as_tensor(getattr(value, one.name)) for value in (written, read))
        torch.testing.assert_close(here, there, atol=1e-3 if one.name == "directions" else 0.0, rtol=0.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gaits": torch.zeros(2, 5)}, r"gaits has the shape \(2, 5\)"),
        ({"speeds": torch.zeros(4, 2)}, r"speeds has the shape \(4, 2\)"),
        ({"speeds": torch.tensor([[0.0, 1.0], [2.0, 1.0], [0.0, 1.0]])}, "the second not below the first"),
        ({"speeds": torch.tensor([[0.0, 1.0], [-2.0, 1.0], [0.0, 1.0]])}, "from 0 on"),
        ({"mean": torch.full((WIDTH,), torch.nan)}, "mean hold NaN"),
        ({"quarters": torch.tensor([0.0, 4.0])}, "quarters must be whole numbers from 0 to 3"),
        ({"quarters": torch.tensor([0.0, 0.5])}, "quarters must be whole numbers from 0 to 3"),
        ({"gaits": torch.zeros(0, WIDTH), "from_mps": torch.zeros(0), "quarters": torch.zeros(0)}, "gaits has the"),
    ],
)
def test_invalid_numbers_and_shapes_are_refused(tmp_path: Path, changes: dict[str, Tensor], message: str) -> None:
    write_paces(tmp_path / PACES_FILE, replace(paces(), **changes))
    with pytest.raises(CheckpointError, match=message):
        read_paces(tmp_path / PACES_FILE, WIDTH)


def test_paces_of_another_text_encoder_are_refused(tmp_path: Path) -> None:
    write_paces(tmp_path / PACES_FILE, paces(16))
    with pytest.raises(CheckpointError, match="W = 32"):
        read_paces(tmp_path / PACES_FILE, WIDTH)


def test_a_file_that_lacks_tensors_is_refused(tmp_path: Path) -> None:
    from safetensors.torch import save_file

    save_file({"mean": torch.zeros(WIDTH)}, tmp_path / PACES_FILE)
    with pytest.raises(CheckpointError, match="directions"):
        read_paces(tmp_path / PACES_FILE, WIDTH)


def test_integer_tensors_are_refused(tmp_path: Path) -> None:
    from safetensors.torch import load_file, save_file

    write_paces(tmp_path / PACES_FILE, paces())
    tensors = load_file(tmp_path / PACES_FILE)
    save_file(tensors | {"quarters": tensors["quarters"].long()}, tmp_path / PACES_FILE)
    with pytest.raises(CheckpointError, match="'quarters' has the type 'I64'; weights must be one of"):
        read_paces(tmp_path / PACES_FILE, WIDTH)


def test_a_model_that_fits_prompts_is_saved_with_its_paces(tmp_path: Path) -> None:
    model = load_checkpoint(TINY)
    model.sampling, model.paces = replace(model.sampling, fit_prompts=True), paces()
    save_checkpoint(model, tmp_path)
    read = load_checkpoint(tmp_path).paces
    assert read is not None
    torch.testing.assert_close(read.gaits, paces().gaits)


def test_a_checkpoint_that_fits_prompts_requires_a_paces_file(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoint"
    shutil.copytree(TINY, folder)
    assert load_checkpoint(folder).paces is None
    (folder / SAMPLING_FILE).write_text(yaml.safe_dump({"fit_prompts": True}))
    with pytest.raises(CheckpointError, match=r"prompt_paces\.safetensors is missing"):
        load_checkpoint(folder)
    write_paces(folder / PACES_FILE, paces())
    read = load_checkpoint(folder).paces
    assert read is not None
    assert read.from_mps.tolist() == pytest.approx([0.0, 0.15])
