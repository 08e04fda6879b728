"""The recipe of a training: the sections of a training configuration, read from YAML and checked.

`tokenizer`, `denoiser` and `model` change fields of the configurations of those names; `transformer` within the first
two changes the network's sizes, `patch` within `tokenizer` the frames per token; `loss` changes the weights of the
loss; `files` names files to copy into the checkpoint.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from motiongen_ardy.checkpoint.files import CheckpointError, read_yaml
from motiongen_ardy.model.config import ConfigError, DenoiserConfig, TokenizerConfig, TransformerConfig
from motiongen_ardy.train.denoiser_loss import LossWeights

Configuration = TypeVar("Configuration")

TEXT_DIM = 256
MINI_TOKENIZER = TokenizerConfig(
    transformer=TransformerConfig(width=128, feed_forward=512, num_layers=4, num_heads=4),
    latent_dim=64,
    levels=(64,) * 64,
)
MINI_DENOISER = DenoiserConfig(
    transformer=TransformerConfig(width=256, feed_forward=512, num_layers=5, num_heads=4),
    latent_dim=64,
    text_tokens=1,
    text_dim=TEXT_DIM,
)


@dataclass(frozen=True)
class Recipe:
    """Everything about a model that training decides.

    horizon: frames that one window generates. files: (name in the checkpoint, file to copy) of what accompanies the
    weights, such as sampling options.
    """

    tokenizer: TokenizerConfig = MINI_TOKENIZER
    denoiser: DenoiserConfig = MINI_DENOISER
    loss: LossWeights = field(default_factory=LossWeights)
    horizon: int = 40
    num_base_steps: int = 10
    files: tuple[tuple[str, Path], ...] = ()


def read_recipe(path: Path | None) -> Recipe:
    """The recipe in a YAML file, completed by that of the built-in model (None: entirely).

    Raises ConfigError for a file that is not such a mapping, for unknown or duplicate keys, and for values with which
    nothing can be built.
    """
    if path is None:
        return Recipe()
    try:
        content = read_yaml(path)
    except CheckpointError as error:
        raise ConfigError(error.problems) from error
    sections = _mapping(content, str(path), ("tokenizer", "denoiser", "model", "loss", "files"))
    tokenizer = dict(_mapping(sections.get("tokenizer", {}), "tokenizer", _names(TokenizerConfig)))
    if isinstance(tokenizer.get("levels"), int) and "latent_dim" in tokenizer:
        tokenizer["levels"] = (tokenizer["levels"],) * _whole("tokenizer.latent_dim", tokenizer["latent_dim"])
    model = _mapping(sections.get("model", {}), "model", ("horizon", "num_base_steps"))
    changed_tokenizer = _changed(MINI_TOKENIZER, tokenizer, "tokenizer")
    shared = {"latent_dim": changed_tokenizer.latent_dim, "patch": changed_tokenizer.patch}
    denoiser = {**shared, **_mapping(sections.get("denoiser", {}), "denoiser", None)}
    return Recipe(
        tokenizer=changed_tokenizer,
        denoiser=_changed(MINI_DENOISER, denoiser, "denoiser"),
        loss=_changed(LossWeights(), _mapping(sections.get("loss", {}), "loss", None), "loss"),
        files=_files(_mapping(sections.get("files", {}), "files", None), path.parent),
        **{key: _whole(f"model.{key}", value) for key, value in model.items()},
    )


def _changed(base: Configuration, changes: Mapping[str, Any], where: str) -> Configuration:
    """A configuration with some fields changed; a nested mapping changes fields of the field's own value."""
    _mapping(changes, where, _names(type(base)))
    values = {}
    for key, value in changes.items():
        old = getattr(base, key)
        if isinstance(old, TransformerConfig):
            value = _changed(old, _mapping(value, f"{where}.{key}", None), f"{where}.{key}")
        elif isinstance(old, tuple):
            value = tuple(value) if isinstance(value, list | tuple) else value
        if not isinstance(value, type(old)) and not (isinstance(old, float) and type(value) is int):
            raise ConfigError(f"{where}.{key} is {value!r}; it must be like {old!r}")
        values[key] = value
    return replace(base, **values)  # type: ignore[type-var]


def _files(given: Mapping[str, Any], folder: Path) -> tuple[tuple[str, Path], ...]:
    """(name in the checkpoint, file) of each entry; files are looked for in the recipe's folder."""
    for name, source in given.items():
        plain = isinstance(name, str) and Path(name).name == name
        if not plain or not isinstance(source, str) or not (folder / source).is_file():
            raise ConfigError(f"files.{name} is {source!r}; give a plain name, and a file that lies in {folder}")
    return tuple((name, folder / source) for name, source in given.items())


def _names(kind: type) -> tuple[str, ...]:
    return tuple(entry.name for entry in fields(kind))


def _whole(where: str, value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise ConfigError(f"{where} is {value!r}; it must be a whole number")
    return value


def _mapping(content: object, where: str, known: tuple[str, ...] | None) -> Mapping[str, Any]:
    if not isinstance(content, Mapping):
        raise ConfigError(f"{where} is {content!r}; it must be a mapping")
    unknown = sorted(str(key) for key in content if known is not None and key not in known)
    if unknown:
        raise ConfigError(f"{where} has unknown keys {', '.join(unknown)}; known keys are {', '.join(known or ())}")
    return content
