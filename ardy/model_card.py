"""A model's folder by name, and what its card says: licence and attribution."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import yaml

CARD_FILE = "MODEL_CARD.md"
BUILT_IN_MODEL = "motiongen-mini"


class UnknownModel(ValueError):
    """Raised for a name that is neither a built-in model nor a checkpoint folder; the message lists what is known."""


@dataclass(frozen=True)
class ModelCard:
    """model_id: the name to ask for; licence: of the weights, "unknown" where the folder has no card."""

    model_id: str
    licence: str
    attribution: str


def built_in_models() -> tuple[str, ...]:
    """The names of the models that come with the package."""
    folder = Path(str(resources.files("ardy") / "pretrained"))
    return tuple(sorted(path.parent.name for path in folder.glob("*/config.yaml")))


def model_folder(name: str) -> Path:
    """The checkpoint folder of a built-in model's name or of a path. Raises UnknownModel."""
    if name in built_in_models():
        return Path(str(resources.files("ardy") / "pretrained" / name))
    folder = Path(name)
    if not (folder / "config.yaml").is_file():
        known = ", ".join(built_in_models()) or "none"
        raise UnknownModel(f"no model {name!r}; built-in models: {known}; or give a checkpoint folder")
    return folder


def read_model_card(folder: Path) -> ModelCard:
    """What the front matter of a folder's card says; a folder without a card gets its own name and no licence."""
    path = folder / CARD_FILE
    front: dict[str, object] = {}
    if path.is_file():
        parts = path.read_text(encoding="utf-8").split("---", 2)
        loaded = yaml.safe_load(parts[1]) if len(parts) == 3 else None
        front = loaded if isinstance(loaded, dict) else {}
    return ModelCard(
        model_id=str(front.get("name", folder.resolve().name)),
        licence=str(front.get("licence", "unknown")),
        attribution=str(front.get("attribution", "")),
    )
