"""JointMap: which of our joints drives which joint of a user's skeleton: the retarget file of `docs/data.md`, inverted.

The file says how a user's joint drives ours: with T the orientation of the user's joint axes in our neutral pose, our
joint has the world rotation of the user's times T^-1. Inverted, the user's has the world rotation of ours times T.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.kinematics import axis_angle_to_quaternion, quaternion_to_matrix

Float64 = NDArray[np.float64]

DIRECTIONS: Mapping[str, tuple[int, int, int]] = {
    "left": (1, 0, 0),
    "right": (-1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
    "forward": (0, 0, 1),
    "back": (0, 0, -1),
}
# name, skeleton, fill and feet matter only for the direction from the user's skeleton to ours
_KEYS = ("name", "skeleton", "metres_per_unit", "values", "groups", "joints", "fill", "follow", "root", "feet")


@dataclass(frozen=True, eq=False)
class Drive:
    """What drives one of the user's joints.

    ours: our joint, twice, or two joints between whose world rotations it interpolates at `fraction`. axes: (3, 3); the
    columns are the x, y and z axes of the user's joint when the body stands in our neutral pose.
    """

    ours: tuple[str, str]
    fraction: float
    axes: Float64


@dataclass(frozen=True, eq=False)
class JointMap:
    """A checked joint map. Made by `of` or `read_joint_map`.

    drives: by the user's joint. root_theirs, root_ours: sets of joints whose midpoints coincide. scale: metres of ours
    per metre of theirs; None: from the lengths of leg_chains (theirs, ours). ground_theirs: height in their units that
    matches ground_ours_m; None: the lowest of feet_ours is at ground_ours_m when the lowest of theirs is at its height
    at rest.
    """

    metres_per_unit: float
    drives: Mapping[str, Drive]
    root_theirs: tuple[str, ...]
    root_ours: tuple[str, ...]
    scale: float | None
    leg_chains: tuple[tuple[tuple[str, ...], ...], tuple[tuple[str, ...], ...]] = ((), ())
    ground_theirs: float | None = 0.0
    ground_ours_m: float = 0.0
    feet_ours: tuple[str, ...] = ()

    @classmethod
    def of(cls, document: Mapping[str, Any], group: str = "") -> JointMap:
        """The map of a document with the file's content. group: the rest group whose values apply.

        Raises InvalidInput, which names the place.
        """
        _check_keys("joint map", document, _KEYS, ("metres_per_unit", "joints", "root"))
        groups = _section("groups", document.get("groups", {}))
        if group and group not in groups:
            raise InvalidInput("group", group, f"one of {', '.join(groups) or '(none)'}")
        of_group = _section(f"groups.{group}", groups.get(group, {}))
        values = {**_section("values", document.get("values", {})), **of_group}
        unit = _positive("metres_per_unit", document["metres_per_unit"])
        drives: dict[str, Drive] = {}
        for ours, rule in _section("joints", document["joints"]).items():
            place = f"joints.{ours}"
            _check_keys(place, rule, ("from", "axes", "turn"), ("from",))
            (theirs,) = _names(f"{place}.from", [rule["from"]])
            if theirs not in drives:  # if several of ours follow one of theirs, the first drives it
                drives[theirs] = Drive((ours, ours), 0.0, _axes(place, rule, values))
        for theirs, rule in _section("follow", document.get("follow", {})).items():
            place = f"follow.{theirs}"
            if theirs in drives:
                raise InvalidInput(place, theirs, "a joint that no rule of joints names already")
            drives[theirs] = _follow(place, rule, values)
        root = document["root"]
        _check_keys("root", root, ("from", "to", "scale", "ground"), ("from", "to", "scale", "ground"))
        scale, chains = _scale(root["scale"])
        ground_theirs, ground_ours_m, feet = _ground(root["ground"], values)
        middle_theirs, middle_ours = _names("root.from", root["from"]), _names("root.to", root["to"])
        return cls(unit, drives, middle_theirs, middle_ours, scale, chains, ground_theirs, ground_ours_m, feet)


def read_joint_map(path: str | Path, group: str = "") -> JointMap:
    """The map of a JSON file. For a YAML file, give what a YAML reader returns to `JointMap.of`.

    Raises InvalidInput, and OSError for a file that cannot be read.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8-sig"))  # some editors write a byte order mark
    except (ValueError, RecursionError) as error:  # not JSON, not UTF-8, or nested too deeply
        raise InvalidInput("path", str(path), f"a file of JSON ({error})") from None
    return JointMap.of(document, group)


def directions(words: Sequence[str]) -> Float64:
    """(3, 3); the columns are the directions of three words."""
    return np.array([DIRECTIONS[word] for word in words], np.float64).T


def _section(place: str, given: Any) -> Mapping[str, Any]:
    if not isinstance(given, Mapping):
        raise InvalidInput(place, given, "a mapping whose keys are names")
    return given


def _check_keys(place: str, section: Any, known: Sequence[str], required: Sequence[str]) -> None:
    if not isinstance(section, Mapping):
        raise InvalidInput(place, section, f"the keys {', '.join(known)}")
    for key in section:
        if key not in known:
            raise InvalidInput(f"{place}.{key}", section[key], f"the keys {', '.join(known)}")
    for key in required:
        if key not in section:
            raise InvalidInput(place, list(section), f"the key {key} as well")


def _number(place: str, value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # a whole number that no float can hold
            number = math.inf
        if math.isfinite(number):
            return number
    raise InvalidInput(place, value, "a finite number")


def _positive(place: str, value: Any) -> float:
    number = _number(place, value)
    if number <= 0:
        raise InvalidInput(place, value, "a number above 0")
    return number


def _names(place: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or not value or not all(isinstance(name, str) for name in value):
        raise InvalidInput(place, value, "a list of joints' names")
    return tuple(value)


def _named(place: str, value: Any, values: Mapping[str, float]) -> float:
    if isinstance(value, str) and value not in values:
        raise InvalidInput(place, value, f"a number, or one of {', '.join(values) or '(none)'}")
    return _number(place, values[value] if isinstance(value, str) else value)


def _is_direction(word: Any) -> bool:
    return isinstance(word, str) and word in DIRECTIONS


def _axes(place: str, rule: Mapping[str, Any], values: Mapping[str, float]) -> Float64:
    words = rule.get("axes", ("left", "up", "forward"))
    if not isinstance(words, list | tuple) or len(words) != 3 or not all(map(_is_direction, words)):
        raise InvalidInput(f"{place}.axes", words, f"three of {', '.join(DIRECTIONS)}")
    axes = directions(words)
    if round(float(np.linalg.det(axes))) != 1:
        raise InvalidInput(f"{place}.axes", words, "a right-handed set of three directions")
    if "turn" not in rule:
        return axes
    turn = rule["turn"]
    _check_keys(f"{place}.turn", turn, ("about", "degrees"), ("about", "degrees"))
    if not _is_direction(turn["about"]):
        raise InvalidInput(f"{place}.turn.about", turn["about"], f"one of {', '.join(DIRECTIONS)}")
    angle = math.radians(_named(f"{place}.turn.degrees", turn["degrees"], values))
    quaternion = axis_angle_to_quaternion(angle * np.array(DIRECTIONS[turn["about"]], np.float64))
    return np.asarray(quaternion_to_matrix(quaternion) @ axes, np.float64)


def _follow(place: str, rule: Any, values: Mapping[str, float]) -> Drive:
    _check_keys(place, rule, ("from", "between", "fraction", "axes", "turn"), ())
    if ("from" in rule) == ("between" in rule) or ("between" in rule) != ("fraction" in rule):
        raise InvalidInput(place, list(rule), "from, or between with fraction")
    if "from" in rule:
        (name,) = _names(f"{place}.from", [rule["from"]])
        return Drive((name, name), 0.0, _axes(place, rule, values))
    ends = _names(f"{place}.between", rule["between"])
    fraction = _number(f"{place}.fraction", rule["fraction"])
    if len(ends) != 2 or not 0 <= fraction <= 1:
        raise InvalidInput(place, rule, "two of our joints, and a fraction from 0 to 1")
    return Drive((ends[0], ends[1]), fraction, _axes(place, rule, values))


def _scale(value: Any) -> tuple[float | None, tuple[tuple[tuple[str, ...], ...], tuple[tuple[str, ...], ...]]]:
    if not isinstance(value, Mapping):
        return _positive("root.scale", value), ((), ())
    _check_keys("root.scale", value, ("from", "to"), ("from", "to"))
    return None, (_chains("root.scale.from", value["from"]), _chains("root.scale.to", value["to"]))


def _chains(place: str, value: Any) -> tuple[tuple[str, ...], ...]:
    """Chains of two joints or more each, since one alone has no length."""
    chains = tuple(_names(place, chain) for chain in value) if isinstance(value, list | tuple) else ()
    if not chains or any(len(chain) < 2 for chain in chains):
        raise InvalidInput(place, value, "a chain of two joints or more, or several")
    return chains


def _ground(value: Any, values: Mapping[str, float]) -> tuple[float | None, float, tuple[str, ...]]:
    known = ("source_height", "lowest_of", "percentile", "height")
    _check_keys("root.ground", value, known, ("height",))
    height_m = _number("root.ground.height", value["height"])
    if "source_height" in value:
        return _named("root.ground.source_height", value["source_height"], values), height_m, ()
    if "lowest_of" not in value:
        raise InvalidInput("root.ground", value, "source_height, or lowest_of, beside height")
    return None, height_m, _names("root.ground.lowest_of", value["lowest_of"])
