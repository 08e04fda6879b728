"""Scenario files: what is read, what is refused, and which characters belong to which group."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_client.errors import UnknownName
from motiongen_client.types import Priority
from motiongen_tools.bench.scenario import BUILT_IN, Group, InvalidScenario, Scenario, load_scenario, read_scenario
from motiongen_tools.bench.schedule import make_schedule
from motiongen_tools.bench.yaml_content import parse_yaml

ROOT = Path(__file__).resolve().parents[3]


def document() -> dict[str, Any]:
    group = {"name": "crowd", "share": 1, "priority": "CROWD", "prompts": ["walk", "run"]}
    edits = [{"kind": "prompt", "every_s": 2}]
    return {
        "format": 1,
        "name": "small",
        "revision": 3,
        "description": "A small one.",
        "characters": 4,
        "ramp_s": 1,
        "settle_s": 1,
        "groups": [{**group, "edits": edits}],
    }


def read(document: Any) -> Scenario:
    return read_scenario(yaml.safe_dump(document).encode(), "small.yaml")


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_scenarios_can_be_read(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert sum(group.share for group in scenario.groups) == pytest.approx(1)


def test_a_scenario_file_is_read() -> None:
    scenario = read(document())
    assert (scenario.name, scenario.revision, scenario.characters) == ("small", 3, 4)
    assert scenario.groups[0].priority is Priority.CROWD
    assert scenario.groups[0].edits[0].timing == "regular"
    assert scenario.sha256 != read({**document(), "revision": 4}).sha256


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "format: 2 was given"),
        ({"characters": 0}, "characters: 0 was given; allowed is a whole number from 1 to 1000000"),
        ({"characters": True}, "characters: True was given"),
        ({"ramp_s": float("nan")}, "ramp_s: nan was given; allowed is a number from 0 to 3600"),
        ({"ramp": 1}, "ramp is not known here; known are format, name"),
        ({"groups": []}, "groups: [] was given; allowed is a list of one or more"),
        ({"groups": ["crowd"]}, "groups[0]: 'crowd' was given; allowed is a mapping"),
        ({"name": " "}, "name: ' ' was given; allowed is a text that is not blank"),
    ],
)
def test_invalid_fields_are_reported(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidScenario) as failure:
        read({**document(), **change})
    assert message in str(failure.value)
    assert str(failure.value).startswith("small.yaml: ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"share": 0.5}, "the shares add up to 0.5; they must add up to 1"),
        ({"name": "all"}, "'all' means all groups"),
        ({"priority": "crowd"}, "groups[0].priority: 'crowd' was given; allowed is one of HERO, NEAR, CROWD, BATCH"),
        ({"prompts": ["walk"]}, "two prompts or more where an edit of kind prompt chooses"),
        ({"edits": [{"kind": "jump", "every_s": 1}]}, "groups[0].edits[0].kind: 'jump' was given"),
        ({"edits": [{"kind": "prompt", "every_s": 0}]}, "groups[0].edits[0].every_s: 0 was given"),
        (
            {"edits": [{"kind": "prompt", "every_s": 1, "waypoints": 3}]},
            "groups[0].edits[0].waypoints is not known here",
        ),
        ({"life": {"median_s": 3}}, "groups[0].life.sigma is missing"),
    ],
)
def test_invalid_fields_of_a_group_are_reported_with_their_place(change: dict[str, Any], message: str) -> None:
    wrong = document()
    wrong["groups"][0] |= change
    with pytest.raises(InvalidScenario) as failure:
        read(wrong)
    assert message in str(failure.value)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"a: [", b"!!python/object/apply:os.getcwd []", b"3"])
def test_content_that_is_not_a_scenario_is_refused(content: bytes) -> None:
    with pytest.raises(InvalidScenario):
        read_scenario(content, "small.yaml")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"name: a\nformat: 1\nname: b", "a.yaml: line 3 gives 'name' again"),
        (b'{"format": 1,\n "groups": [{"share": 1, "share": 2}]}', "a.yaml: line 2 gives 'share' again"),
    ],
)
def test_names_that_are_there_twice_are_refused(content: bytes, message: str) -> None:
    with pytest.raises(InvalidScenario, match=message):
        read_scenario(content, "a.yaml")


def test_a_name_may_replace_a_merged_one() -> None:
    merged = parse_yaml(b"usual: &usual {share: 1, priority: NEAR}\ncrowd: {<<: *usual, priority: CROWD}")
    assert merged == {"usual": {"share": 1, "priority": "NEAR"}, "crowd": {"share": 1, "priority": "CROWD"}}


def test_lives_of_one_length_can_be_drawn_whichever_sign_their_zero_has() -> None:
    whole = document()
    whole["groups"][0]["life"] = {"median_s": 3, "sigma": -0.0}
    plans = make_schedule(read(whole), 4, 10, seed=1).characters
    lives_s = [plan.close_s - plan.open_s for plan in plans[4:] if math.isfinite(plan.close_s)]
    assert lives_s == pytest.approx([3] * len(lives_s))
    assert lives_s


def test_the_example_in_the_documentation_is_valid() -> None:
    page = (ROOT / "docs" / "benchmarking.md").read_text(encoding="utf-8")
    example = re.search(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert example is not None
    scenario = read_scenario(example[1].encode(), "benchmarking.md")
    assert [rule.kind for rule in scenario.groups[0].edits] == ["prompt", "constraints", "velocity"]
    for name in BUILT_IN:
        assert f"| {name} |" in page


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownName, match="crowd, hero, planner, churn, storm, mixed"):
        load_scenario("crowds")
    with pytest.raises(InvalidScenario, match="cannot be read"):
        load_scenario("nowhere/crowd.yaml")


@settings(deadline=None)
@given(st.lists(st.integers(1, 20), min_size=1, max_size=5), st.integers(1, 200))
def test_any_number_of_characters_is_divided_by_the_shares(weights: list[int], num_characters: int) -> None:
    groups = tuple(
        Group(str(index), weight / sum(weights), Priority.NEAR, ("walk",)) for index, weight in enumerate(weights)
    )
    chosen = dataclasses.replace(read(document()), groups=groups).group_indices(num_characters)
    for index, group in enumerate(groups):
        assert abs(chosen.count(index) - group.share * num_characters) <= len(groups)
    assert dataclasses.replace(read(document()), groups=groups).group_indices(num_characters + 1)[:-1] == chosen


def nested_lists(depth: int) -> str:
    """A list of ten lists of ten lists, in a few lines."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]" for level in range(1, depth)]
    return "\n".join([*lines, f"format: *a{depth - 1}"])


@pytest.mark.parametrize("content", ["[" * 5000, "format: " + "9" * 5000, "format: 2020-99-99", nested_lists(30)])
def test_pathological_yaml_is_refused_with_a_short_message(content: str) -> None:
    with pytest.raises(InvalidScenario, match=r"small\.yaml: ") as refusal:
        read_scenario(content.encode(), "small.yaml")
    assert len(str(refusal.value)) < 400
