"""Finds a model's folder by the model's name, and reads licence and attribution from its card."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from motiongen_ardy.checkpoint.files import CheckpointError, parse_yaml
from motiongen_ardy.checkpoint.hub import fetch_checkpoint
from motiongen_ardy.checkpoint.released import NICKNAMES, RELEASED, RELEASED_BY

CARD_FILES = ("MODEL_CARD.md", "README.md")
MAX_NAME_CHARACTERS = 1024
MAX_CARD_BYTES = 1 << 20
MAX_SAID_CHARACTERS = 2000
MAX_LISTED = 20
BUILT_IN_MODEL = "motiongen-mini"
CHECKPOINTS_DIR = "CHECKPOINTS_DIR"
REPOSITORY = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}", re.ASCII)
REVISION = re.compile(r"[A-Za-z0-9][\w./-]{0,199}", re.ASCII)


class UnknownModel(ValueError):
    """Raised for a name that is not that of a model; the message lists the known ones."""


@dataclass(frozen=True)
class ModelCard:
    """model_id: the name to load the model by; licence: of the weights, "unknown" if the folder has no card."""

    model_id: str
    licence: str
    attribution: str


def built_in_models() -> tuple[str, ...]:
    """The names of the models that come with the package."""
    folder = Path(str(resources.files("motiongen_ardy") / "pretrained"))
    return tuple(sorted(path.parent.name for path in folder.glob("*/config.yaml")))


def model_folder(name: str) -> Path:
    """The checkpoint folder for a name, downloaded if necessary.

    Tried in this order: a built-in model; a folder; a folder in `$CHECKPOINTS_DIR`; a released model, by
    nickname or full name; a repository `owner/name` of the Hugging Face hub. The last two may end in `@revision`
    (commit, tag or branch), which is requested from the hub or its cache. Raises UnknownModel, and HubError if the hub
    fails.
    """
    if len(name) > MAX_NAME_CHARACTERS:
        raise UnknownModel(f"a name of {len(name)} characters; give one of at most {MAX_NAME_CHARACTERS}")
    if name in built_in_models():
        return Path(str(resources.files("motiongen_ardy") / "pretrained" / name))
    if name and (_path(name) / "config.yaml").is_file():
        return _path(name)
    given, at, revision = name.partition("@")
    full_name = NICKNAMES.get(given, given)
    local = None if at or not _is_one_name(full_name) else _local_checkpoint(full_name)
    if local is not None:
        return local
    repository = f"{RELEASED_BY}/{full_name}" if full_name in RELEASED else given
    fits = REPOSITORY.fullmatch(repository) and ".." not in repository
    if not fits or (at and not REVISION.fullmatch(revision)) or _path(given).exists():
        raise UnknownModel(_what_is_known(name))
    return fetch_checkpoint(repository, revision or None)


def _path(name: str) -> Path:
    """A path as a shell reads it; `~name` is left as it is if there is no such user."""
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)


def _is_one_name(name: str) -> bool:
    return bool(name) and name not in (".", "..") and not set(name) & set("/\\\0")


def _local_checkpoint(full_name: str) -> Path | None:
    """The folder of that name in `$CHECKPOINTS_DIR`; None if there is none."""
    home = os.environ.get(CHECKPOINTS_DIR)
    folder = _path(home) / full_name if home else None
    return folder if folder is not None and (folder / "config.yaml").is_file() else None


def _what_is_known(name: str) -> str:
    folder = _path(name) if name and "\0" not in name else None
    if folder is not None and folder.is_dir():
        return f"the folder {name!r} holds no config.yaml; a checkpoint folder does"
    return (
        f"no model {name[:200]!r}; give a built-in model ({', '.join(built_in_models()) or 'none'}), a released one "
        f"({', '.join(NICKNAMES)}, or its full name), a checkpoint folder, a folder's name in ${CHECKPOINTS_DIR}, "
        "or a repository owner/name[@revision] of the Hugging Face hub"
    )


def read_model_card(folder: Path) -> ModelCard:
    """The front matter of a folder's card; a folder without a card gets its own name and no licence."""
    front = next((front for name in CARD_FILES if (front := _front_matter(folder / name))), {})
    licence = _said(front, "licence") or _said(front, "license_name") or _said(front, "license")
    return ModelCard(
        model_id=_said(front, "name") or _own_name(folder),
        licence=licence or "unknown",
        attribution=_said(front, "attribution"),
    )


def _said(front: dict[str, object], key: str) -> str:
    """The text, or list of texts, under a key, cut to a readable length; "" if there is none."""
    value = front.get(key)
    said = [one for one in value[:MAX_LISTED] if isinstance(one, str)] if isinstance(value, list) else [value]
    texts = [str(one)[:MAX_SAID_CHARACTERS] for one in said if one is not None and not isinstance(one, dict | set)]
    return ", ".join(texts)[:MAX_SAID_CHARACTERS]


def _own_name(folder: Path) -> str:
    """A folder's name; in the hub's cache, where that is a commit, the repository's name instead."""
    folder = folder.resolve()
    repository = folder.parent.parent.name
    if folder.parent.name == "snapshots" and repository.startswith("models--"):
        return repository.rpartition("--")[2]
    return folder.name


def _front_matter(path: Path) -> dict[str, object]:
    """The YAML between the first two lines of dashes; empty if there is none or it cannot be read."""
    try:
        if not path.is_file() or path.stat().st_size > MAX_CARD_BYTES:
            return {}
        parts = path.read_text(encoding="utf-8-sig").split("---", 2)
        loaded = parse_yaml(parts[1], path) if len(parts) == 3 and not parts[0].strip() else None
    except (OSError, UnicodeDecodeError, CheckpointError):
        return {}
    return loaded if isinstance(loaded, dict) else {}
