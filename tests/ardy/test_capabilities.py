"""The capabilities file of a checkpoint: read in full, or refused with all its mistakes."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from motiongen_ardy.capabilities import (
    CAPABILITIES_FILE,
    FORMS,
    Capabilities,
    parse_capabilities,
    read_capabilities,
)
from motiongen_ardy.checkpoint.files import CheckpointError, read_yaml
from motiongen_ardy.text.domain import DOMAIN_FILE, make_domain, write_domain
from motiongen_ardy.train.prompt_domain import CONFIGS

WHOLE: dict[str, Any] = {
    "forms": dict.fromkeys(FORMS, "trained") | {"keyframe": "warn", "feet": "refuse"},
    "presets": [{"name": "walk", "text": "a person walks", "what": "walks"}, {"name": "run", "text": "run"}],
    "locomotion": [
        {"name": "stand", "text": "stand", "from_mps": 0},
        {"name": "back", "text": "go back", "from_mps": 0.2, "to_mps": 1.5, "direction": "backward"},
    ],
    "knows": ["walking"],
}


def _written(folder: Path, content: object) -> Path:
    (folder / CAPABILITIES_FILE).write_text(yaml.safe_dump(content), encoding="utf-8")
    return folder


def test_a_complete_file_is_read(tmp_path: Path) -> None:
    found = read_capabilities(_written(tmp_path, WHOLE))
    assert (found.forms["keyframe"], found.forms["feet"], found.forms["waypoint"]) == ("warn", "refuse", "trained")
    assert [(preset.name, preset.what) for preset in found.presets] == [("walk", "walks"), ("run", "")]
    assert [(gait.from_mps, gait.direction) for gait in found.locomotion] == [(0.0, "forward"), (0.2, "backward")]
    assert [gait.to_mps for gait in found.locomotion] == [math.inf, 1.5]
    assert found.knows == ("walking",)
    assert found.domain is None


def test_without_a_file_no_capabilities_are_claimed(tmp_path: Path) -> None:
    assert read_capabilities(tmp_path) == Capabilities()


def test_a_prompt_domain_is_read_and_requires_the_known_prompts_in_words(tmp_path: Path) -> None:
    domain = make_domain("static-1", np.eye(3, dtype=np.float32), 3)
    write_domain(tmp_path / DOMAIN_FILE, domain)
    with pytest.raises(CheckpointError, match=CAPABILITIES_FILE):
        read_capabilities(tmp_path)
    found = read_capabilities(_written(tmp_path, WHOLE)).domain
    assert found is not None
    assert found.text_encoder == "static-1"
    with pytest.raises(CheckpointError, match="knows"):
        read_capabilities(_written(tmp_path, {**WHOLE, "knows": []}))
    (tmp_path / DOMAIN_FILE).write_bytes(b"nonsense")
    with pytest.raises(CheckpointError, match=DOMAIN_FILE):
        read_capabilities(tmp_path)


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        (("jumps",), True, "unknown key 'jumps'"),
        (("forms", "jumps"), "trained", "unknown key 'jumps'"),
        (("forms", "hands"), "perhaps", r"forms\.hands is 'perhaps'"),
        (("forms",), {"hands": "trained"}, "forms lacks waypoint"),
        (("forms",), ["hands"], "forms is"),
        (("presets",), {"walk": "walk"}, "presets is"),
        (("presets", 0, "text"), " ", r"presets\[0\]\.text"),
        (("presets", 0, "text"), "x" * 201, r"presets\[0\]\.text"),
        (("presets", 1, "name"), "walk", "walk twice"),
        (("presets", 0, "speed"), 1, r"presets\[0\] has the unknown key"),
        (("locomotion", 0, "from_mps"), float("nan"), r"locomotion\[0\]\.from_mps"),
        (("locomotion", 0, "from_mps"), True, r"locomotion\[0\]\.from_mps"),
        (("locomotion", 0, "from_mps"), 0.5, "forward from 0"),
        (("locomotion", 1, "to_mps"), "fast", r"locomotion\[1\]\.to_mps is 'fast'"),
        (("locomotion", 1, "to_mps"), 0.1, r"locomotion\[1\]\.to_mps is 0.1; give metres a second from 0.2 to 10"),
        (("locomotion", 1, "to_mps"), float("nan"), r"locomotion\[1\]\.to_mps"),
        (("locomotion", 1, "direction"), "up", r"locomotion\[1\]\.direction"),
        (("knows", 0), 3, r"knows\[0\]"),
    ],
)
def test_a_mistake_is_reported_with_its_place(path: tuple[Any, ...], value: object, told: str) -> None:
    content: Any = copy.deepcopy(WHOLE)
    holder = content
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    with pytest.raises(CheckpointError, match=told):
        parse_capabilities(content, "file")


def test_all_mistakes_are_listed_at_once() -> None:
    with pytest.raises(CheckpointError) as caught:
        parse_capabilities({"forms": {"hands": 1}, "knows": [""], "more": 2}, "file")
    assert len(caught.value.problems) == 4


def test_the_file_of_the_built_in_model_is_valid() -> None:
    found = parse_capabilities(read_yaml(CONFIGS / "mini-capabilities.yaml"), "mini")
    assert set(found.forms) == set(FORMS)
    speeds = {gait.name: gait.from_mps for gait in found.locomotion if gait.direction == "forward"}
    assert speeds == {"stand": 0.0, "walk": 0.15, "run": 2.0}
    fastest = {gait.name: gait.to_mps for gait in found.locomotion if gait.to_mps < math.inf}
    assert fastest == {"run": 3.0, "walk-back": 1.2, "walk-left": 1.2, "walk-right": 1.2}
    assert found.knows
