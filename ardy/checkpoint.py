"""A checkpoint folder: weights, config and statistics in the released layout, read and written without pickle."""

from __future__ import annotations

from pathlib import Path

import torch
import yaml
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from ardy.checkpoint_config import (
    read_model_config,
    read_tokenizer_config,
    write_model_config,
    write_tokenizer_config,
)
from ardy.model import Model, build_model
from ardy.representation import LOCAL_ROOT_WIDTH, Representation
from ardy.skeleton import load_skeleton
from ardy.stats import load_stats, save_stats
from ardy.tokenizer import Tokenizer, build_tokenizer

CONFIG_FILE = "config.yaml"
DENOISER_FILE = "denoiser.safetensors"
TOKENIZER_FILE = "tokenizer.safetensors"
MAX_CONFIG_BYTES = 1 << 20


class CheckpointError(ValueError):
    """Raised for a folder that is not a complete, consistent checkpoint; the message lists what is wrong."""


def load_checkpoint(folder: str | Path, device: str | torch.device = "cpu") -> Model:
    """The model of a checkpoint folder, in evaluation mode, float32, on `device`.

    Raises CheckpointError for missing files and for missing, extra or misshapen tensors (all are listed), ConfigError
    for a config that cannot be built, StatsError for bad statistics. Nothing in the folder is executed.
    """
    folder = Path(folder)
    config = read_model_config(_read_yaml(folder / CONFIG_FILE))
    feature_dim = load_skeleton(config.skeleton).feature_dim
    model = build_model(config, load_stats(folder / "stats" / "motion", feature_dim + LOCAL_ROOT_WIDTH))
    _load_weights(model.denoiser, _denoiser_tensors(_read_tensors(folder / DENOISER_FILE)), folder / DENOISER_FILE)
    if model.tokenizer is not None:
        _fill_tokenizer(model.tokenizer, folder)
    return model.to(device).eval().requires_grad_(False)


def save_checkpoint(model: Model, folder: str | Path) -> None:
    """Write a model as a checkpoint folder that `load_checkpoint`, and the public ARDY loader, can read."""
    folder = Path(folder)
    _write_yaml(write_model_config(model.config), folder / CONFIG_FILE)
    denoiser = {
        f"denoiser.{'backbone.' if name.startswith(('root_model.', 'body_model.')) else ''}{name}": tensor
        for name, tensor in _plain_tensors(model.denoiser).items()
    }
    save_file(denoiser, folder / DENOISER_FILE)
    save_stats(model.representation.stats, folder / "stats" / "motion")
    if model.tokenizer is not None:
        _write_tokenizer_files(model.tokenizer, folder)


def load_tokenizer(folder: str | Path, device: str | torch.device = "cpu") -> Tokenizer:
    """The tokenizer of a checkpoint folder, which may lack a denoiser. Raises as `load_checkpoint` does."""
    folder = Path(folder)
    config, skeleton_name, fps = read_tokenizer_config(_read_yaml(folder / CONFIG_FILE))
    skeleton = load_skeleton(skeleton_name)
    stats = load_stats(folder / "stats" / "motion", skeleton.feature_dim + LOCAL_ROOT_WIDTH)
    tokenizer = build_tokenizer(config, Representation(skeleton, fps, stats))
    _fill_tokenizer(tokenizer, folder)
    return tokenizer.to(device).eval().requires_grad_(False)


def save_tokenizer(tokenizer: Tokenizer, folder: str | Path) -> None:
    """Write a folder that `load_tokenizer` can read: a checkpoint without a denoiser."""
    folder = Path(folder)
    layout = tokenizer.representation
    _write_yaml(write_tokenizer_config(tokenizer.config, layout.skeleton.name, layout.fps), folder / CONFIG_FILE)
    save_stats(layout.stats, folder / "stats" / "motion")
    _write_tokenizer_files(tokenizer, folder)


def _fill_tokenizer(tokenizer: Tokenizer, folder: Path) -> None:
    tokenizer.post_stats = load_stats(folder / "stats" / "post_quantization", tokenizer.config.latent_dim)
    tokenizer.pre_stats = load_stats(folder / "stats" / "pre_quantization", tokenizer.config.latent_dim)
    _load_weights(tokenizer, _tokenizer_tensors(_read_tensors(folder / TOKENIZER_FILE)), folder / TOKENIZER_FILE)


def _write_tokenizer_files(tokenizer: Tokenizer, folder: Path) -> None:
    tensors = {f"pose_net.{name}": tensor for name, tensor in _plain_tensors(tokenizer).items()}
    save_file(tensors, folder / TOKENIZER_FILE)
    save_stats(tokenizer.post_stats, folder / "stats" / "post_quantization")
    save_stats(tokenizer.pre_stats, folder / "stats" / "pre_quantization")


def _write_yaml(content: dict[str, object], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _plain_tensors(module: nn.Module) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().float().contiguous() for name, tensor in module.state_dict().items()}


def _read_yaml(path: Path) -> object:
    try:
        if path.stat().st_size > MAX_CONFIG_BYTES:
            raise CheckpointError(f"{path} is larger than {MAX_CONFIG_BYTES} bytes; that is not a model configuration")
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CheckpointError(f"{path} is missing; a checkpoint folder holds {CONFIG_FILE}, {DENOISER_FILE}, "
                              f"{TOKENIZER_FILE} and stats/") from None  # fmt: skip
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CheckpointError(f"{path} is not readable YAML: {error}") from error


def _read_tensors(path: Path) -> dict[str, Tensor]:
    try:
        return load_file(path)
    except FileNotFoundError:
        raise CheckpointError(f"{path} is missing; the checkpoint is not complete") from None
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path} is not a readable safetensors file: {error}") from error


def _denoiser_tensors(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {
        name.replace("denoiser.", "").replace("backbone.", ""): tensor
        for name, tensor in tensors.items()
        if name.startswith("denoiser")
    }


def _tokenizer_tensors(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    prefix = "pose_net."
    return {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith("pose_net")}


def _load_weights(module: nn.Module, tensors: dict[str, Tensor], path: Path) -> None:
    expected = module.state_dict()
    problems = [f"missing {name} {tuple(expected[name].shape)}" for name in expected.keys() - tensors.keys()]
    problems += [f"extra {name} {tuple(tensors[name].shape)}" for name in tensors.keys() - expected.keys()]
    for name in sorted(expected.keys() & tensors.keys()):
        if expected[name].shape != tensors[name].shape:
            problems.append(f"{name} is {tuple(tensors[name].shape)}, expected {tuple(expected[name].shape)}")
        elif not tensors[name].isfinite().all():
            problems.append(f"{name} holds NaN or infinite numbers")
    if problems:
        raise CheckpointError(f"{path} does not match its config.yaml: " + "; ".join(sorted(problems)))
    module.load_state_dict(tensors)
