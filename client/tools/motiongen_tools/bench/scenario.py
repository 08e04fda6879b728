"""Scenario: the definition of a load, read from a YAML or JSON file and checked once."""

from __future__ import annotations

import hashlib
import math
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from motiongen_client.errors import MotiongenError, UnknownName
from motiongen_client.types import Priority
from motiongen_tools.bench.yaml_content import parse_yaml

FORMAT = 1
BUILT_IN = ("crowd", "hero", "planner", "churn", "storm", "mixed")
EDIT_KINDS = ("prompt", "constraints", "velocity")
TIMINGS = ("regular", "random", "together")


class InvalidScenario(MotiongenError, ValueError):
    """A scenario file that cannot be used. The message names the field, what was given and what is allowed."""


@dataclass(frozen=True)
class EditRule:
    """Edits that the characters of a group receive again and again.

    kind: prompt (another of the group's prompts), constraints (waypoints along a path, replacing the previous ones) or
    velocity (a stick held in a direction that turns). every_s: seconds between two edits of a character. timing:
    regular (each character at a phase of its own), random (a Poisson process), together (all at the same times).
    waypoints: number in a constraints edit. ahead_s: from the playhead to the first of them. spacing_frames: from one
    to the next. speed_m_s: along the path, or of the stick. hold_s: how long a velocity holds without a new one.
    """

    kind: str
    every_s: float
    timing: str = "regular"
    waypoints: int = 1
    ahead_s: float = 2.0
    spacing_frames: int = 4
    speed_m_s: float = 1.2
    hold_s: float = 0.5


@dataclass(frozen=True)
class Life:
    """How long characters live: log-normal. median_s: seconds; sigma: standard deviation of the logarithm."""

    median_s: float
    sigma: float

    @property
    def mean_s(self) -> float:
        return self.median_s * math.exp(self.sigma**2 / 2)


@dataclass(frozen=True)
class Group:
    """Characters of one kind. share: of all characters. life: None means for the whole run.

    With a life, characters open as a Poisson process, at the rate that keeps the size of the group steady.
    """

    name: str
    share: float
    priority: Priority
    prompts: tuple[str, ...]
    edits: tuple[EditRule, ...] = ()
    life: Life | None = None


@dataclass(frozen=True)
class Scenario:
    """A load that can be played with any number of characters.

    revision: raised whenever the file changes the load. characters: the default number. characters_per_stream: on one
    call. ramp_s: over which the opens are spread; settle_s: after it, before measuring; tail_s: for which the load
    continues after measuring, so that the last edits can be answered. report_hz: playhead reports of a character.
    sha256: of the file.
    """

    name: str
    revision: int
    description: str
    characters: int
    characters_per_stream: int
    ramp_s: float
    settle_s: float
    tail_s: float
    report_hz: float
    groups: tuple[Group, ...]
    sha256: str

    def group_indices(self, num_characters: int) -> list[int]:
        """The group of each character. For every n, the shares among the first n are as exact as n allows."""
        counts, chosen = [0] * len(self.groups), []
        for number in range(1, num_characters + 1):
            deficits = [group.share * number - count for group, count in zip(self.groups, counts, strict=True)]
            chosen.append(deficits.index(max(deficits)))
            counts[chosen[-1]] += 1
        return chosen


def load_scenario(name_or_file: str) -> Scenario:
    """A built-in scenario by its name, or one from a file. Raises InvalidScenario, UnknownName."""
    path = Path(name_or_file)
    if name_or_file in BUILT_IN:
        source = resources.files("motiongen_tools.bench") / "scenarios" / f"{name_or_file}.yaml"
        return read_scenario(source.read_bytes(), f"{name_or_file}.yaml")
    if path.suffix not in (".yaml", ".yml", ".json") and not path.is_file():
        raise UnknownName("scenario", name_or_file, [*BUILT_IN, "or a file that ends in .yaml or .json"])
    try:
        return read_scenario(path.read_bytes(), str(path))
    except OSError as error:
        raise InvalidScenario(f"{path} cannot be read: {error.strerror}") from None


def read_scenario(content: bytes, where: str) -> Scenario:
    """A scenario from the bytes of its file. Raises InvalidScenario, whose message begins with `where`."""
    try:
        document = parse_yaml(content)
    except ValueError as error:
        raise InvalidScenario(f"{where}: {error}") from None
    top = _Fields(document, where, "")
    given = top.take("format", _whole(1))
    if given != FORMAT:
        raise InvalidScenario(f"{where}: format: {given} was given; this version of motiongen reads {FORMAT}")
    scenario = Scenario(
        name=top.take("name", _text),
        revision=top.take("revision", _whole(1)),
        description=top.take("description", _text),
        characters=top.take("characters", _whole(1, 1_000_000)),
        characters_per_stream=top.take("characters_per_stream", _whole(1, 100_000), 500),
        ramp_s=top.take("ramp_s", _number(0, 3600)),
        settle_s=top.take("settle_s", _number(0, 3600)),
        tail_s=top.take("tail_s", _number(0, 60), 3.0),
        report_hz=top.take("report_hz", _number(1, 5), 2.0),
        groups=tuple(_group(fields) for fields in top.take_list("groups")),
        sha256=hashlib.sha256(content).hexdigest(),
    )
    top.finish()
    names = [group.name for group in scenario.groups]
    if len(set(names)) < len(names) or "all" in names:
        raise InvalidScenario(
            f"{where}: groups: the names are {', '.join(names)}; each may be used once, and 'all' means all groups"
        )
    total = sum(group.share for group in scenario.groups)
    if abs(total - 1) > 1e-6:
        raise InvalidScenario(f"{where}: groups: the shares add up to {total:g}; they must add up to 1")
    return scenario


def _group(fields: _Fields) -> Group:
    life = fields.take_fields("life")
    group = Group(
        name=fields.take("name", _text),
        share=fields.take("share", _number(1e-6, 1)),
        priority=Priority[fields.take("priority", _one_of(tuple(priority.name for priority in Priority)))],
        prompts=fields.take("prompts", _texts),
        edits=tuple(_edit_rule(rule) for rule in fields.take_list("edits", allow_empty=True)),
        life=_life(life) if life is not None else None,
    )
    if len(group.prompts) < 2 and any(rule.kind == "prompt" for rule in group.edits):
        raise fields.refusal("prompts", list(group.prompts), "two prompts or more where an edit of kind prompt chooses")
    fields.finish()
    return group


def _life(fields: _Fields) -> Life:
    life = Life(fields.take("median_s", _number(0.5, 86_400)), fields.take("sigma", _number(0, 3)))
    fields.finish()
    return life


def _edit_rule(fields: _Fields) -> EditRule:
    kind = fields.take("kind", _one_of(EDIT_KINDS))
    every_s = fields.take("every_s", _number(0.02, 86_400))
    timing = fields.take("timing", _one_of(TIMINGS), "regular")
    more: dict[str, Any] = {}
    if kind == "constraints":
        more["waypoints"] = fields.take("waypoints", _whole(1, 1000), 1)
        more["ahead_s"] = fields.take("ahead_s", _number(0, 60), 2.0)
        more["spacing_frames"] = fields.take("spacing_frames", _whole(1, 1000), 4)
    if kind in ("constraints", "velocity"):
        more["speed_m_s"] = fields.take("speed_m_s", _number(0, 20), 1.2)
    if kind == "velocity":
        more["hold_s"] = fields.take("hold_s", _number(0.05, 60), 0.5)
    fields.finish()
    return EditRule(kind, every_s, timing, **more)


_REQUIRED = object()


class _Fields:
    """A mapping in the file. Keys are taken one by one; finish() reports a key that was not, listing the known ones."""

    def __init__(self, value: object, where: str, path: str) -> None:
        self._where, self._path = where, path
        if not isinstance(value, Mapping):
            place = path.removesuffix(".") or "the file"
            raise InvalidScenario(f"{where}: {place}: {_shown(value)} was given; allowed is a mapping")
        self._values = value
        self._known: list[str] = []

    def take(self, name: str, convert: Callable[[object], Any], default: Any = _REQUIRED) -> Any:
        self._known.append(name)
        if name not in self._values:
            if default is _REQUIRED:
                raise InvalidScenario(f"{self._where}: {self._path}{name} is missing")
            return default
        try:
            return convert(self._values[name])
        except _NotAllowed as error:
            raise self.refusal(name, self._values[name], str(error)) from None

    def take_list(self, name: str, allow_empty: bool = False) -> list[_Fields]:
        self._known.append(name)
        values = self._values.get(name, [] if allow_empty else None)
        if not isinstance(values, list) or (not values and not allow_empty):
            raise self.refusal(name, values, "a list" if allow_empty else "a list of one or more")
        return [_Fields(value, self._where, f"{self._path}{name}[{i}].") for i, value in enumerate(values)]

    def take_fields(self, name: str) -> _Fields | None:
        self._known.append(name)
        if name not in self._values:
            return None
        return _Fields(self._values[name], self._where, f"{self._path}{name}.")

    def finish(self) -> None:
        unknown = [str(name) for name in self._values if name not in self._known]
        if unknown:
            raise InvalidScenario(
                f"{self._where}: {self._path}{unknown[0]} is not known here; known are {', '.join(self._known)}"
            )

    def refusal(self, name: str, given: object, allowed: str) -> InvalidScenario:
        return InvalidScenario(f"{self._where}: {self._path}{name}: {_shown(given)} was given; allowed is {allowed}")


class _NotAllowed(ValueError):
    """A value outside what is allowed; the message says what is."""


_SHORT = reprlib.Repr()
_SHORT.maxlevel, _SHORT.maxstring, _SHORT.maxlong, _SHORT.maxother = 3, 60, 60, 60


def _shown(value: object) -> str:
    text = _SHORT.repr(value)  # aliases can nest a value into itself without end
    return text if len(text) <= 60 else text[:57] + "..."


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise _NotAllowed("a text that is not blank")
    return " ".join(value.split())


def _texts(value: object) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(text, str) and text.strip() for text in value):
        raise _NotAllowed("a list of texts that are not blank")
    return tuple(value)


def _one_of(names: tuple[str, ...]) -> Callable[[object], str]:
    def convert(value: object) -> str:
        if not isinstance(value, str) or value not in names:
            raise _NotAllowed(f"one of {', '.join(names)}")
        return value

    return convert


def _number(least: float, most: float) -> Callable[[object], float]:
    def convert(value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
            raise _NotAllowed(f"a number from {least:g} to {most:g}")
        return float(value) + 0.0  # minus zero becomes zero: a standard deviation has no sign

    return convert


def _whole(least: int, most: int = 1_000_000_000) -> Callable[[object], int]:
    def convert(value: object) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise _NotAllowed(f"a whole number from {least} to {most}")
        return value

    return convert
