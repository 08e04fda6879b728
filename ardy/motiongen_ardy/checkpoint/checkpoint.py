"""A checkpoint folder: weights, config and statistics in the released layout, read and written without pickle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from motiongen_ardy.checkpoint.config import (
    DENOISER_FILE,
    MOTION_STATS,
    TOKENIZER_FILE,
    FolderLayout,
    read_model_config,
    read_tokenizer_config,
)
from motiongen_ardy.checkpoint.config_writer import write_model_config, write_tokenizer_config
from motiongen_ardy.checkpoint.files import CheckpointError, TensorFile, path_inside, read_yaml
from motiongen_ardy.checkpoint.paces_file import PACES_FILE, read_paces, write_paces
from motiongen_ardy.checkpoint.sampling_file import SAMPLING_FILE, read_options, write_options
from motiongen_ardy.checkpoint.stats import load_stats, save_stats
from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.problems import Problems
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH, Representation
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import ConfigError, ModelConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.precision import PRECISIONS, matrix_names, set_precision
from motiongen_ardy.model.sampling.limbs import arms
from motiongen_ardy.model.sampling.options import SamplingOptions, released_options
from motiongen_ardy.model.sampling.paces import PromptPaces
from motiongen_ardy.model.tokenizer import Tokenizer, build_tokenizer

CONFIG_FILE = "config.yaml"
PART = TypeVar("PART")


def load_checkpoint(
    folder: str | Path, device: str | torch.device = "cpu", dtype: torch.dtype = torch.float32
) -> Model:
    """The model of a checkpoint folder, in evaluation mode, on `device`.

    dtype: float32 or bfloat16, of the weight matrices (`motiongen_ardy.model.precision`). Raises CheckpointError with
    everything that is wrong: files missing, unreadable or outside the folder; config keys and values; tensors missing,
    extra, misshapen or not finite; statistics. Nothing in the folder is executed, and no memory is allocated for
    tensors before config, header and file size agree.
    """
    check_precision(dtype)
    folder = Path(folder)
    config, layout = _read_config(folder, read_model_config)
    problems: list[str] = []
    feature_dim = load_skeleton(config.skeleton).feature_dim
    stats = _collect(problems, lambda: _read_stats(folder, layout.motion_stats, feature_dim + LOCAL_ROOT_WIDTH))
    with torch.device("meta"):
        model = _built(folder, lambda: build_model(config, stats or _identity_stats(feature_dim + LOCAL_ROOT_WIDTH)))
    sampling = _collect(problems, lambda: _read_sampling(folder, config))
    model.sampling = sampling or model.sampling
    model.paces = _collect(problems, lambda: _read_paces(folder, config, model.sampling))
    fill_denoiser = _collect(problems, lambda: _prepare(model.denoiser, folder, layout.denoiser, _denoiser_name, dtype))
    fill_tokenizer = None
    if model.tokenizer is not None:
        fill_tokenizer = _prepare_tokenizer(model.tokenizer, folder, layout, dtype, problems)
    for fill in (fill_denoiser, fill_tokenizer) if not problems else ():
        if fill is not None:
            _collect(problems, fill)
    if problems:
        raise CheckpointError(problems)
    return model.to(device).eval().requires_grad_(False)


def load_tokenizer(
    folder: str | Path, device: str | torch.device = "cpu", dtype: torch.dtype = torch.float32
) -> Tokenizer:
    """The tokenizer of a checkpoint folder, which may lack a denoiser. Raises as `load_checkpoint` does."""
    check_precision(dtype)
    folder = Path(folder)
    config, skeleton_name, fps, layout = _read_config(folder, read_tokenizer_config)
    skeleton = load_skeleton(skeleton_name)
    width = skeleton.feature_dim + LOCAL_ROOT_WIDTH
    problems: list[str] = []
    stats = _collect(problems, lambda: _read_stats(folder, layout.motion_stats, width))
    with torch.device("meta"):
        features = Representation(skeleton, fps, stats or _identity_stats(width))
        tokenizer = _built(folder, lambda: build_tokenizer(config, features))
    fill = _prepare_tokenizer(tokenizer, folder, layout, dtype, problems)
    if fill is not None and not problems:
        _collect(problems, fill)
    if problems:
        raise CheckpointError(problems)
    return tokenizer.to(device).eval().requires_grad_(False)


def save_checkpoint(model: Model, folder: str | Path) -> None:
    """Write a model as a checkpoint folder that `load_checkpoint`, and the public ARDY loader, can read.

    The paces of prompts are written if the model has them; otherwise those already in the folder are kept.
    """
    folder = Path(folder)
    _write_yaml(write_model_config(model.config), folder / CONFIG_FILE)
    denoiser = {
        f"denoiser.{'backbone.' if name.startswith(('root_model.', 'body_model.')) else ''}{name}": tensor
        for name, tensor in _plain_tensors(model.denoiser).items()
    }
    _write_tensors(denoiser, folder / DENOISER_FILE)
    save_stats(model.representation.stats, folder / MOTION_STATS)
    if model.sampling != released_options(model.config.guidance):
        _write_yaml(write_options(model.sampling), folder / SAMPLING_FILE)
    else:
        (folder / SAMPLING_FILE).unlink(missing_ok=True)
    if model.paces is not None:
        write_paces(folder / PACES_FILE, model.paces)
    if model.tokenizer is not None:
        _write_tokenizer_files(model.tokenizer, folder)


def save_tokenizer(tokenizer: Tokenizer, folder: str | Path) -> None:
    """Write a checkpoint folder without a denoiser, which `load_tokenizer` can read."""
    folder = Path(folder)
    layout = tokenizer.representation
    _write_yaml(write_tokenizer_config(tokenizer.config, layout.skeleton.name, layout.fps), folder / CONFIG_FILE)
    save_stats(layout.stats, folder / MOTION_STATS)
    _write_tokenizer_files(tokenizer, folder)


def check_precision(dtype: torch.dtype) -> None:
    """Raise ConfigError for a type in which weights cannot be held."""
    if dtype not in PRECISIONS.values():
        raise ConfigError(f"dtype is {dtype}; weights are held as {' or '.join(PRECISIONS)}")


# ---- reading --------------------------------------------------------------------------------------------------------


def _collect(problems: list[str], read: Callable[[], PART]) -> PART | None:
    """The result of `read`; None if it refuses, with its problems added to `problems`."""
    try:
        return read()
    except Problems as error:
        problems += error.problems
        return None


def _read_config(folder: Path, read: Callable[[object], PART]) -> PART:
    content = read_yaml(path_inside(folder, CONFIG_FILE))
    return _built(folder, lambda: read(content))


def _read_sampling(folder: Path, config: ModelConfig) -> SamplingOptions:
    """The options in `sampling.yaml`; without that file, those of the released models. Raises CheckpointError."""
    path = path_inside(folder, SAMPLING_FILE)
    if not path.exists():
        return released_options(config.guidance)
    try:
        options = read_options(read_yaml(path), config.guidance)
        if options.clean_feet or options.reach_joints:
            arms(load_skeleton(config.skeleton))
        return options
    except ConfigError as error:
        raise CheckpointError([f"{path}: {problem}" for problem in error.problems]) from error


def _read_paces(folder: Path, config: ModelConfig, sampling: SamplingOptions) -> PromptPaces | None:
    """The paces of prompts, or None. Raises CheckpointError, also if they are missing but sampling needs them."""
    path = path_inside(folder, PACES_FILE)
    if path.exists():
        return read_paces(path, config.denoiser.text_dim)
    if sampling.fit_prompts:
        raise CheckpointError(
            f"{path} is missing, which {SAMPLING_FILE} needs for fit_prompts; make it with"
            " `python -m motiongen_ardy.train.prompt_paces`, or set fit_prompts to false"
        )
    return None


def _built(folder: Path, build: Callable[[], PART]) -> PART:
    """The result of `build`; a ConfigError that it raises becomes a CheckpointError that names the folder's config."""
    try:
        return build()
    except ConfigError as error:
        raise CheckpointError([f"{folder / CONFIG_FILE}: {problem}" for problem in error.problems]) from error


def _read_stats(folder: Path, relative: str, width: int) -> Stats:
    for name in ("mean.npy", "std.npy"):
        path_inside(folder, f"{relative}/{name}")
    return load_stats(folder / relative, width)


def _identity_stats(width: int) -> Stats:
    return Stats(torch.zeros(width, device="cpu"), torch.ones(width, device="cpu"))


def _prepare_tokenizer(
    tokenizer: Tokenizer, folder: Path, layout: FolderLayout, dtype: torch.dtype, problems: list[str]
) -> Callable[[], None] | None:
    """Give a tokenizer its statistics and check its tensors; problems are added to `problems`."""
    width = tokenizer.config.latent_dim
    for name in ("post", "pre"):
        relative = f"{layout.latent_stats}/{name}_quantization"
        stats = _collect(problems, lambda relative=relative: _read_stats(folder, relative, width))
        setattr(tokenizer, f"{name}_stats", stats or _identity_stats(width))
    return _collect(problems, lambda: _prepare(tokenizer, folder, layout.tokenizer, _tokenizer_name, dtype))


def _prepare(
    module: nn.Module, folder: Path, relative: str, name_of: Callable[[str], str | None], dtype: torch.dtype
) -> Callable[[], None]:
    """Check a file's header against a module without tensors; returns a function that then reads them into it.

    name_of: maps a tensor's name in the file to ours; None for tensors that are not the module's.
    """
    file = TensorFile(path_inside(folder, relative))
    stored: dict[str, str] = {}
    problems = []
    for name in file.entries:
        ours = name_of(name)
        if ours in stored:
            problems.append(f"{name[:200]!r} and {stored[ours][:200]!r} are both {ours[:200]!r}")
        elif ours is not None:
            stored[ours] = name
    file.require_weights(stored.values())
    expected = {name: tuple(tensor.shape) for name, tensor in module.state_dict().items()}
    for name in sorted(expected.keys() | stored.keys()):
        shape = file.entries[stored[name]].shape if name in stored else None
        if shape is None:
            problems.append(f"missing {name} {expected[name]}")
        elif name not in expected:
            problems.append(f"extra {name[:200]!r} {shape}")
        elif shape != expected[name]:
            problems.append(f"{name} is {shape}, expected {expected[name]}")
    if problems:
        raise CheckpointError([f"{file.path}: {problem}" for problem in problems])
    return lambda: _fill(module, file, stored, dtype)


def _fill(module: nn.Module, file: TensorFile, stored: dict[str, str], dtype: torch.dtype) -> None:
    matrices = matrix_names(module)
    read = file.read({stored[name]: dtype if name in matrices else torch.float32 for name in stored})
    tensors = {name: read.pop(stored[name]) for name in stored}
    broken = [name for name, tensor in tensors.items() if not bool(tensor.isfinite().all())]
    if broken:
        raise CheckpointError([f"{file.path}: {name} holds NaN or infinite numbers" for name in sorted(broken)])
    module.load_state_dict(tensors, assign=True)
    set_precision(module, dtype)


def _denoiser_name(name: str) -> str | None:
    return name.replace("denoiser.", "").replace("backbone.", "") if name.startswith("denoiser") else None


def _tokenizer_name(name: str) -> str | None:
    return name.removeprefix("pose_net.") if name.startswith("pose_net") else None


# ---- writing --------------------------------------------------------------------------------------------------------


def _write_tokenizer_files(tokenizer: Tokenizer, folder: Path) -> None:
    tensors = {f"pose_net.{name}": tensor for name, tensor in _plain_tensors(tokenizer).items()}
    _write_tensors(tensors, folder / TOKENIZER_FILE)
    save_stats(tokenizer.post_stats, folder / "stats" / "post_quantization")
    save_stats(tokenizer.pre_stats, folder / "stats" / "pre_quantization")


def _write_tensors(tensors: dict[str, Tensor], path: Path) -> None:
    from safetensors.torch import save_file

    with written_whole(path) as partial:
        save_file(tensors, partial)


def _write_yaml(content: dict[str, object], path: Path) -> None:
    import yaml

    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as partial:
        partial.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _plain_tensors(module: nn.Module) -> dict[str, Tensor]:
    return {name: tensor.detach().cpu().float().contiguous() for name, tensor in module.state_dict().items()}
