"""What a checkpoint was trained for: `capabilities.yaml` and the prompt domain beside it, both optional."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motiongen_ardy.checkpoint.files import CheckpointError, path_inside, read_yaml
from motiongen_ardy.text.domain import DOMAIN_FILE, DomainError, PromptDomain, read_domain

CAPABILITIES_FILE = "capabilities.yaml"
FORMS = (
    "waypoint", "waypoint_heading", "trajectory", "trajectory_heading", "keyframe", "hands", "feet", "joints",
    "head_rotation", "joint_rotations", "root_height", "velocity", "velocity_heading",
)  # fmt: skip
SUPPORT = ("trained", "warn", "refuse")
DIRECTIONS = ("forward", "left", "backward", "right")
MAX_TEXT = 200
MAX_ENTRIES = 64
MAX_SPEED_MPS = 10.0


@dataclass(frozen=True)
class PresetPrompt:
    """A prompt that shows what the model can do. what: the motion to expect."""

    name: str
    text: str
    what: str


@dataclass(frozen=True)
class LocomotionPreset:
    """The prompt for moving in a direction, relative to the body's facing, at from_mps metres a second or more.

    to_mps: above this speed the feet slide; infinity if no such speed is stated.
    """

    name: str
    text: str
    from_mps: float
    direction: str
    to_mps: float = math.inf

    @property
    def quarter(self) -> int:
        """The direction as a quarter turn: 0 forward, 1 left, 2 backward, 3 right, as in `locomotion.gait`."""
        return DIRECTIONS.index(self.direction)


@dataclass(frozen=True)
class Capabilities:
    """forms: one of SUPPORT for every entry of FORMS; empty if the file says nothing about them.

    knows: in words, what the captions are about. domain: None if the folder has no file of it.
    """

    forms: Mapping[str, str] = field(default_factory=dict)
    presets: tuple[PresetPrompt, ...] = ()
    locomotion: tuple[LocomotionPreset, ...] = ()
    knows: tuple[str, ...] = ()
    domain: PromptDomain | None = None


def read_capabilities(folder: Path) -> Capabilities:
    """What a checkpoint folder says about its training; empty if it has no such files. Raises CheckpointError."""
    path, domain_path = path_inside(folder, CAPABILITIES_FILE), path_inside(folder, DOMAIN_FILE)
    try:
        domain = read_domain(domain_path) if domain_path.exists() else None
    except DomainError as error:
        raise CheckpointError(str(error)) from error
    if not path.exists():
        if domain is not None:
            raise CheckpointError(f"{domain_path} is there without {CAPABILITIES_FILE}, which says what it is of")
        return Capabilities()
    return parse_capabilities(read_yaml(path), str(path), domain)


def parse_capabilities(content: object, where: str, domain: PromptDomain | None = None) -> Capabilities:
    """Parse the content of a capabilities file, named `where` in messages. Raises CheckpointError with all mistakes."""
    reading = _Reading()
    top = reading.mapping(content, "the file", ("forms", "presets", "locomotion", "knows"))
    found = Capabilities(
        forms=reading.forms(top.get("forms")),
        presets=tuple(reading.preset(entry, at) for entry, at in reading.entries(top.get("presets"), "presets")),
        locomotion=tuple(reading.gait(entry, at) for entry, at in reading.entries(top.get("locomotion"), "locomotion")),
        knows=tuple(reading.text(entry, at) for entry, at in reading.entries(top.get("knows"), "knows")),
        domain=domain,
    )
    reading.check_names(found)
    if domain is not None and not found.knows:
        reading.problems.append(f"knows is empty beside {DOMAIN_FILE}; say in words what the model knows")
    if reading.problems:
        raise CheckpointError([f"{where}: {problem}" for problem in reading.problems])
    return found


class _Reading:
    """Reads one file and collects its mistakes."""

    def __init__(self) -> None:
        self.problems: list[str] = []

    def mapping(self, value: object, at: str, known: tuple[str, ...]) -> dict[str, Any]:
        if not isinstance(value, dict):
            self.problems.append(f"{at} is {_shown(value)}; give a mapping of {', '.join(known)}")
            return {}
        self.problems += [
            f"{at} has the unknown key {_shown(key)}; known are {', '.join(known)}" for key in value if key not in known
        ]
        return value

    def forms(self, value: object) -> dict[str, str]:
        """All forms or none: a form that a file leaves out must not count as trained."""
        if value is None:
            return {}
        given = self.mapping(value, "forms", FORMS)
        missing = [form for form in FORMS if form not in given]
        if missing:
            self.problems.append(f"forms lacks {', '.join(missing)}; give each one of {', '.join(SUPPORT)}")
        for form, support in given.items():
            if form in FORMS and support not in SUPPORT:
                self.problems.append(f"forms.{form} is {_shown(support)}; give one of {', '.join(SUPPORT)}")
        return {form: given[form] for form in FORMS if form in given}

    def entries(self, value: object, at: str) -> list[tuple[object, str]]:
        if value is None:
            return []
        if not isinstance(value, list) or len(value) > MAX_ENTRIES:
            self.problems.append(f"{at} is {_shown(value)}; give a list of at most {MAX_ENTRIES}")
            return []
        return [(entry, f"{at}[{index}]") for index, entry in enumerate(value)]

    def preset(self, entry: object, at: str) -> PresetPrompt:
        given = self.mapping(entry, at, ("name", "text", "what"))
        name, text = (self.text(given.get(key), f"{at}.{key}") for key in ("name", "text"))
        return PresetPrompt(name, text, self.text(given["what"], f"{at}.what") if "what" in given else "")

    def gait(self, entry: object, at: str) -> LocomotionPreset:
        given = self.mapping(entry, at, ("name", "text", "from_mps", "to_mps", "direction"))
        name, text = (self.text(given.get(key), f"{at}.{key}") for key in ("name", "text"))
        least, direction = self.speed(given.get("from_mps"), 0.0, f"{at}.from_mps"), given.get("direction", "forward")
        most = self.speed(given["to_mps"], least, f"{at}.to_mps") if "to_mps" in given else math.inf
        if direction not in DIRECTIONS:
            self.problems.append(f"{at}.direction is {_shown(direction)}; give one of {', '.join(DIRECTIONS)}")
            direction = "forward"
        return LocomotionPreset(name, text, least, direction, most)

    def speed(self, value: object, least: float, at: str) -> float:
        if isinstance(value, int | float) and not isinstance(value, bool) and least <= value <= MAX_SPEED_MPS:
            return float(value)
        self.problems.append(f"{at} is {_shown(value)}; give metres a second from {least:g} to {MAX_SPEED_MPS:g}")
        return least

    def text(self, value: object, at: str) -> str:
        if isinstance(value, str) and value.strip() and len(value) <= MAX_TEXT:
            return value
        self.problems.append(f"{at} is {_shown(value)}; give a text of 1 to {MAX_TEXT} characters")
        return ""

    def check_names(self, found: Capabilities) -> None:
        """No two presets may share a name, and no two gaits a direction and from_mps."""
        keys: dict[str, list[object]] = {
            "presets": [preset.name for preset in found.presets],
            "locomotion": [(gait.direction, gait.from_mps) for gait in found.locomotion],
        }
        for at, each in keys.items():
            twice = sorted({str(key) for key in each if each.count(key) > 1})
            if twice and not self.problems:
                self.problems.append(f"{at} has {', '.join(twice)} twice")
        forward = [gait.from_mps for gait in found.locomotion if gait.direction == "forward"]
        if found.locomotion and 0.0 not in forward and not self.problems:
            self.problems.append("locomotion has no entry forward from 0 metres a second, which is for standing")


def _shown(value: object) -> str:
    return repr(value)[:80]
