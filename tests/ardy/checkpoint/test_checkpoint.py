"""Checkpoint folders: round trip, and every way in which one can be broken."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import load_file, save_file

from motiongen_ardy.checkpoint.checkpoint import (
    CheckpointError,
    load_checkpoint,
    load_tokenizer,
    save_checkpoint,
    save_tokenizer,
)
from motiongen_ardy.checkpoint.config import FolderLayout, read_model_config
from motiongen_ardy.checkpoint.config_writer import write_model_config
from tests.ardy.conftest import GOLDEN, GoldenModel

TINY = GOLDEN / "tiny-core27" / "checkpoint"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of a valid checkpoint, to be broken."""
    return Path(shutil.copytree(TINY, tmp_path / "model"))


def change_config(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "config.yaml"
    content = yaml.safe_load(path.read_text())
    change(content)
    path.write_text(yaml.safe_dump(content))


def test_a_saved_checkpoint_loads_unchanged(golden: GoldenModel, tmp_path: Path) -> None:
    save_checkpoint(golden.model, tmp_path)
    again = load_checkpoint(tmp_path)
    assert again.config == golden.model.config
    for (name, before), (_, after) in zip(golden.model.state_dict().items(), again.state_dict().items(), strict=True):
        assert torch.equal(before, after), name
    for original in (golden.folder / "checkpoint").glob("*.safetensors"):
        assert load_file(original).keys() == load_file(tmp_path / original.name).keys()


def test_a_tokenizer_can_be_saved_and_loaded_alone(golden: GoldenModel, tmp_path: Path) -> None:
    assert golden.model.tokenizer is not None
    save_tokenizer(golden.model.tokenizer, tmp_path)
    again = load_tokenizer(tmp_path)
    assert again.config == golden.model.tokenizer.config
    assert torch.equal(again.post_stats.mean, golden.model.tokenizer.post_stats.mean)


def test_config_round_trip(golden: GoldenModel) -> None:
    assert read_model_config(write_model_config(golden.model.config)) == (golden.model.config, FolderLayout())


@pytest.mark.parametrize("name", ["config.yaml", "denoiser.safetensors", "tokenizer.safetensors"])
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(CheckpointError, match=name):
        load_checkpoint(folder)


def test_missing_extra_and_misshapen_tensors_are_all_listed(folder: Path) -> None:
    path = folder / "denoiser.safetensors"
    tensors = load_file(path)
    del tensors["denoiser.future_constraints_proj.bias"]
    tensors["denoiser.surplus"] = torch.zeros(3)
    tensors["denoiser.global_root_hybrid_proj.bias"] = torch.zeros(2)
    save_file(tensors, path)
    with pytest.raises(CheckpointError) as caught:
        load_checkpoint(folder)
    for words in (
        "missing future_constraints_proj.bias",
        "extra 'surplus'",
        "global_root_hybrid_proj.bias is (2,)",
    ):
        assert words in str(caught.value)


@pytest.mark.parametrize("dtype", [torch.int64, torch.bool, torch.uint8, torch.float8_e4m3fn, torch.int16])
def test_types_of_tensors_are_checked_for_weights_only(folder: Path, dtype: torch.dtype) -> None:
    path = folder / "denoiser.safetensors"
    tensors = load_file(path)
    save_file(tensors | {"text_encoder.position_ids": torch.zeros(3, dtype=dtype)}, path)
    load_checkpoint(folder)
    name = "denoiser.global_root_hybrid_proj.bias"
    save_file(tensors | {name: torch.zeros_like(tensors[name], dtype=dtype)}, path)
    with pytest.raises(
        CheckpointError, match=rf"'{name}' has the type '\w+'; weights must be one of F64, F32, F16, BF16"
    ):
        load_checkpoint(folder)


def test_tensors_that_are_not_finite_are_all_listed(folder: Path) -> None:
    path = folder / "denoiser.safetensors"
    tensors = load_file(path)
    tensors["denoiser.backbone.root_model.output_linear.bias"][0] = torch.nan
    tensors["denoiser.global_root_hybrid_proj.weight"][3, 2] = -torch.inf
    save_file(tensors, path)
    with pytest.raises(CheckpointError) as caught:
        load_checkpoint(folder)
    for name in ("root_model.output_linear.bias", "global_root_hybrid_proj.weight"):
        assert f"{name} holds NaN or infinite numbers" in str(caught.value)


def test_a_truncated_file_is_refused(folder: Path) -> None:
    path = folder / "tokenizer.safetensors"
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(CheckpointError, match="not a safetensors file"):
        load_checkpoint(folder)


def test_a_header_that_claims_gigabytes_is_refused(folder: Path) -> None:
    (folder / "denoiser.safetensors").write_bytes((4 << 30).to_bytes(8, "little") + b"{}")
    with pytest.raises(CheckpointError, match="not a safetensors file"):
        load_checkpoint(folder)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda config: config.update(surprise=1), "unknown keys surprise"),
        (lambda config: config["denoiser"].update(depth=3), "unknown keys depth"),
        (lambda config: config.update(_target_="os.system"), "_target_"),
        (lambda config: config["denoiser"].update(_target_="ardy.model.Other"), "_target_"),
        (lambda config: config["denoiser"].pop("llm_shape"), "llm_shape"),
        (lambda config: config.update(gen_horizon_len=42), "multiple of 4"),
        (lambda config: config.update(cfg_type="odd"), "cfg_type"),
        (lambda config: config["denoiser"].update(num_heads=7), "multiple of num_heads"),
        (lambda config: config["autoencoder"].update(num_fsq_levels=8), "latent_dim"),
        (lambda config: config.pop("autoencoder"), r"config\.yaml: .* without a tokenizer it must be 1300"),
    ],
)
def test_a_config_that_cannot_be_built_is_refused(
    folder: Path, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    change_config(folder, change)
    with pytest.raises(CheckpointError, match=words):
        load_checkpoint(folder)


def test_a_config_that_is_not_yaml_or_too_large_is_refused(folder: Path) -> None:
    (folder / "config.yaml").write_text("{unclosed: [")
    with pytest.raises(CheckpointError, match="YAML"):
        load_checkpoint(folder)
    (folder / "config.yaml").write_text("# " + "x" * (1 << 21))
    with pytest.raises(CheckpointError, match="larger"):
        load_checkpoint(folder)


def test_yaml_tags_execute_nothing(folder: Path, tmp_path: Path) -> None:
    marker = tmp_path / "ran"
    (folder / "config.yaml").write_text(f"!!python/object/apply:os.system ['touch {marker}']")
    with pytest.raises(CheckpointError):
        load_checkpoint(folder)
    assert not marker.exists()


def test_bad_statistics_are_refused(folder: Path) -> None:
    path = folder / "stats" / "motion" / "mean.npy"
    mean = np.load(path)
    np.save(path, mean[:-1])
    with pytest.raises(CheckpointError, match="334"):
        load_checkpoint(folder)
    mean[0] = np.nan
    np.save(path, mean)
    with pytest.raises(CheckpointError, match="finite"):
        load_checkpoint(folder)
    path.unlink()
    with pytest.raises(CheckpointError, match="missing"):
        load_checkpoint(folder)


def test_loading_a_model_imports_no_compiler() -> None:
    code = (
        "import sys\n"
        "from motiongen_ardy.checkpoint.checkpoint import load_checkpoint\n"
        "from motiongen_ardy.checkpoint.model_card import model_folder\n"
        "load_checkpoint(model_folder('motiongen-mini'))\n"
        "print(*sys.modules)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"torch._dynamo", "torch._inductor", "sympy", "triton"} & set(loaded)
