"""Reads a retarget description from a small YAML file.

The keys are explained in docs/data.md. Everything that can be checked without motion is checked on reading, so that a
mistake is reported once, by its place in the file, and not for every clip.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from motiongen_ardy.checkpoint.files import CheckpointError, parse_yaml
from motiongen_ardy.core.skeleton import Skeleton, UnknownSkeleton, load_skeleton
from motiongen_ardy.data.retarget_rules import (
    FillRule,
    FixedGround,
    JointRule,
    LegScale,
    MeasuredGround,
    Retarget,
    RetargetError,
)

DIRECTIONS: dict[str, tuple[int, int, int]] = {
    "left": (1, 0, 0),
    "right": (-1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
    "forward": (0, 0, 1),
    "back": (0, 0, -1),
}


def built_in_retargets() -> tuple[Retarget, ...]:
    """The retargets included in the package."""
    folder = resources.files("motiongen_ardy") / "data" / "retargets"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".yaml")), key=lambda entry: entry.name)
    return tuple(read_retarget(entry) for entry in files)


def read_retarget(path: Path | Traversable) -> Retarget:
    """Read and check a retarget file. Raises RetargetError."""
    try:
        document = parse_yaml(path.read_bytes(), Path(str(path)))
    except OSError as error:
        raise RetargetError(f"{path}: cannot be read: {error}") from error
    except CheckpointError as error:
        raise RetargetError(str(error)) from error
    return _Reader(str(path)).retarget(document)


class _Reader:
    """Checks one document; every error gives the place as a dotted path."""

    def __init__(self, source: str) -> None:
        self.source = source

    def error(self, place: str, problem: str) -> RetargetError:
        return RetargetError(f"{self.source}: {place}: {problem}")

    def section(self, value: Any, place: str, known: tuple[str, ...], required: tuple[str, ...]) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self.error(place, f"expected keys {', '.join(known)}; found {value!r}")
        for key in value:
            if key not in known:
                raise self.error(place, f"unknown key {key!r}; known keys are {', '.join(known)}")
        for key in required:
            if key not in value:
                raise self.error(place, f"key {key!r} is missing; known keys are {', '.join(known)}")
        return value

    def mapping(self, value: Any, place: str) -> dict[str, Any]:
        if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
            raise self.error(place, f"expected named entries; found {value!r}")
        return value

    def number(self, value: Any, place: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.error(place, f"expected a number; found {value!r}")
        return float(value)

    def word(self, value: Any, place: str) -> str:
        if not isinstance(value, str):
            raise self.error(place, f"expected a name; found {value!r}")
        return value

    def words(self, value: Any, place: str) -> tuple[str, ...]:
        if not isinstance(value, list) or not value:
            raise self.error(place, f"expected a list of names; found {value!r}")
        return tuple(self.word(item, place) for item in value)

    def one_of(self, value: Any, allowed: tuple[str, ...], what: str, place: str) -> str:
        if value not in allowed:
            raise self.error(place, f"unknown {what} {value!r}; allowed are {', '.join(allowed)}")
        return str(value)

    def named_value(self, value: Any, names: tuple[str, ...], place: str) -> float | str:
        if isinstance(value, str):
            return self.one_of(value, names, "value", place)
        return self.number(value, place)

    def retarget(self, document: Any) -> Retarget:
        required = ("name", "skeleton", "metres_per_unit", "joints", "root")
        top = self.section(document, "top level", (*required, "values", "groups", "fill", "feet", "follow"), required)
        try:
            skeleton = load_skeleton(self.word(top["skeleton"], "skeleton"))
        except UnknownSkeleton as error:
            raise self.error("skeleton", str(error)) from error
        values = self.value_table(top.get("values", {}), "values")
        groups = {
            group: self.value_table(table, f"groups.{group}", tuple(values))
            for group, table in self.mapping(top.get("groups", {}), "groups").items()
        }
        joints = {
            name: self.joint_rule(rule, skeleton, name, tuple(values))
            for name, rule in self.mapping(top["joints"], "joints").items()
        }
        between, identity = self.fill(top.get("fill", {}), skeleton, joints)
        root_keys = ("from", "to", "scale", "ground")
        root = self.section(top["root"], "root", root_keys, root_keys)
        metres_per_unit = self.number(top["metres_per_unit"], "metres_per_unit")
        if metres_per_unit <= 0:
            raise self.error("metres_per_unit", f"must be above 0; found {metres_per_unit}")
        return Retarget(
            name=self.word(top["name"], "name"),
            skeleton=skeleton,
            metres_per_unit=metres_per_unit,
            values=values,
            groups=groups,
            joints=joints,
            between=between,
            identity=identity,
            root_source=self.words(root["from"], "root.from"),
            root_target=self.target_joints(root["to"], skeleton, "root.to"),
            scale=self.scale(root["scale"], skeleton),
            ground=self.ground(root["ground"], skeleton, tuple(values)),
            feet=self.feet(top["feet"], skeleton) if "feet" in top else (),
        )

    def value_table(self, value: Any, place: str, allowed: tuple[str, ...] | None = None) -> dict[str, float]:
        table = self.mapping(value, place)
        for key in table:
            if allowed is not None:
                self.one_of(key, allowed, "value", place)
        return {key: self.number(item, f"{place}.{key}") for key, item in table.items()}

    def target_joint(self, name: Any, skeleton: Skeleton, place: str) -> str:
        return self.one_of(name, skeleton.joint_names, f"joint of {skeleton.name}", place)

    def target_joints(self, value: Any, skeleton: Skeleton, place: str) -> tuple[str, ...]:
        return tuple(self.target_joint(name, skeleton, place) for name in self.words(value, place))

    def joint_rule(self, value: Any, skeleton: Skeleton, name: str, values: tuple[str, ...]) -> JointRule:
        place = f"joints.{self.target_joint(name, skeleton, 'joints')}"
        rule = self.section(value, place, ("from", "axes", "turn"), ("from",))
        axes = self.words(rule.get("axes", ["left", "up", "forward"]), f"{place}.axes")
        for axis in axes:
            self.one_of(axis, tuple(DIRECTIONS), "direction", f"{place}.axes")
        columns = np.array([DIRECTIONS[axis] for axis in axes])
        if columns.shape != (3, 3) or round(float(np.linalg.det(columns))) != 1:
            raise self.error(f"{place}.axes", f"{list(axes)} is not a right-handed set of three directions")
        turn: tuple[str, float | str] | None = None
        if "turn" in rule:
            keys = ("about", "degrees")
            section = self.section(rule["turn"], f"{place}.turn", keys, keys)
            about = self.one_of(section["about"], tuple(DIRECTIONS), "direction", f"{place}.turn.about")
            turn = (about, self.named_value(section["degrees"], values, f"{place}.turn.degrees"))
        return JointRule(self.word(rule["from"], f"{place}.from"), (axes[0], axes[1], axes[2]), turn)

    def fill(
        self, value: Any, skeleton: Skeleton, joints: Mapping[str, JointRule]
    ) -> tuple[dict[str, FillRule], frozenset[str]]:
        between: dict[str, FillRule] = {}
        identity: set[str] = set()
        for name, rule in self.mapping(value, "fill").items():
            place = f"fill.{self.target_joint(name, skeleton, 'fill')}"
            if name in joints:
                raise self.error(place, "this joint already has a source under joints")
            if rule == "identity":
                identity.add(name)
                continue
            keys = ("between", "fraction")
            section = self.section(rule, f"{place} (or the word identity)", keys, keys)
            ends = self.words(section["between"], f"{place}.between")
            if len(ends) != 2:
                raise self.error(f"{place}.between", f"expected two joints; found {len(ends)}")
            for end in ends:
                self.one_of(end, tuple(joints), "joint with a source", f"{place}.between")
            fraction = self.number(section["fraction"], f"{place}.fraction")
            if not 0 <= fraction <= 1:
                raise self.error(f"{place}.fraction", f"must be 0..1; found {fraction}")
            between[name] = FillRule(ends[0], ends[1], fraction)
        missing = [name for name in skeleton.joint_names if name not in joints.keys() | between.keys() | identity]
        if missing:
            raise self.error("fill", f"joints with neither a source nor a fill rule: {', '.join(missing)}")
        if skeleton.joint_names[0] not in joints:
            raise self.error("joints", f"the root joint {skeleton.joint_names[0]} needs a source")
        return between, frozenset(identity)

    def scale(self, value: Any, skeleton: Skeleton) -> float | LegScale:
        if not isinstance(value, dict):
            scale = self.number(value, "root.scale")
            if scale <= 0:
                raise self.error("root.scale", f"must be above 0; found {scale}")
            return scale
        section = self.section(value, "root.scale", ("from", "to"), ("from", "to"))
        for key in ("from", "to"):
            if not isinstance(section[key], list) or not section[key]:
                raise self.error(f"root.scale.{key}", f"expected a list of chains; found {section[key]!r}")
        source = tuple(self.words(chain, "root.scale.from") for chain in section["from"])
        target = tuple(self.target_joints(chain, skeleton, "root.scale.to") for chain in section["to"])
        for key, chains in (("from", source), ("to", target)):
            if any(len(chain) < 2 for chain in chains):
                raise self.error(f"root.scale.{key}", "a chain of one joint has no length; name two or more")
        return LegScale(source, target)

    def ground(self, value: Any, skeleton: Skeleton, values: tuple[str, ...]) -> FixedGround | MeasuredGround:
        known = ("source_height", "lowest_of", "percentile", "height")
        section = self.section(value, "root.ground", known, ("height",))
        height_m = self.number(section["height"], "root.ground.height")
        if section.keys() == {"height", "source_height"}:
            source_height = self.named_value(section["source_height"], values, "root.ground.source_height")
            return FixedGround(source_height, height_m)
        if section.keys() == {"height", "lowest_of", "percentile"}:
            joints = self.target_joints(section["lowest_of"], skeleton, "root.ground.lowest_of")
            percentile = self.number(section["percentile"], "root.ground.percentile")
            if not 0 <= percentile <= 100:
                raise self.error("root.ground.percentile", f"must be 0..100; found {percentile}")
            return MeasuredGround(joints, percentile, height_m)
        raise self.error("root.ground", "give height with source_height, or height with lowest_of and percentile")

    def feet(self, value: Any, skeleton: Skeleton) -> tuple[tuple[str, str], ...]:
        section = self.section(value, "feet", ("from", "to"), ("from", "to"))
        source = self.words(section["from"], "feet.from")
        target = self.target_joints(section["to"], skeleton, "feet.to")
        if len(source) != len(target):
            raise self.error("feet", f"from has {len(source)} joints and to has {len(target)}")
        if len(source) % 2:
            raise self.error("feet", f"has {len(source)} joints; give two for each foot, ankle and toe in turn")
        return tuple(zip(source, target, strict=True))
