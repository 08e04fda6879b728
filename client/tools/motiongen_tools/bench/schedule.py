"""A scenario drawn from a seed before the run: who opens and closes when, and who gets which edit when.

All times are intended ones, in seconds from the start of the run, and nothing that happens in the run changes them.
What a character does depends only on the seed and its number, not on how many characters or processes there are.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motiongen_tools.bench.scenario import EditRule, Group, Scenario

_TOGETHER_PHASE = 0.5  # where in each period of every_s the simultaneous edits of all characters are


@dataclass(frozen=True)
class Phases:
    """Ramp and settling, measuring, and a tail, seconds from the start of the run."""

    ramp_s: float
    measure_from_s: int
    measure_to_s: int
    end_s: float

    @property
    def measure_s(self) -> int:
        return self.measure_to_s - self.measure_from_s


@dataclass(frozen=True)
class CharacterPlan:
    """The life of one character. close_s: infinity if it outlives the run. seed: of its session and of its paths."""

    number: int
    group: int
    open_s: float
    close_s: float
    seed: int
    prompt: int


@dataclass(frozen=True, eq=False)
class Schedule:
    """A drawn load. The arrays are parallel, with one entry per edit, in order of edit_at_s.

    edit_rule: index into the group's edits. edit_value: which prompt, or the running number of the edit under its rule.
    """

    phases: Phases
    characters: tuple[CharacterPlan, ...]
    edit_at_s: NDArray[np.float64]
    edit_character: NDArray[np.int64]
    edit_rule: NDArray[np.int64]
    edit_value: NDArray[np.int64]

    def most_at_once(self) -> int:
        """The greatest number of characters that live at the same time."""
        changes = [(plan.open_s, 1) for plan in self.characters] + [(plan.close_s, -1) for plan in self.characters]
        alive = most = 0
        for _, change in sorted(changes):
            alive += change
            most = max(most, alive)
        return most

    def sha256(self) -> str:
        """Equal for equal loads."""
        digest = hashlib.sha256(repr((self.phases, self.characters)).encode())
        for array in (self.edit_at_s, self.edit_character, self.edit_rule, self.edit_value):
            digest.update(array.tobytes())
        return digest.hexdigest()


def make_phases(scenario: Scenario, seconds: int) -> Phases:
    """The phases of a run. Measuring begins at a whole second, so that values by second cover whole seconds."""
    measure_from_s = math.ceil(scenario.ramp_s + scenario.settle_s)
    measure_to_s = measure_from_s + seconds
    return Phases(scenario.ramp_s, measure_from_s, measure_to_s, measure_to_s + scenario.tail_s)


def make_schedule(scenario: Scenario, num_characters: int, seconds: int, seed: int) -> Schedule:
    """Draw a load. num_characters: how many live at once; if characters come and go, approximately."""
    phases = make_phases(scenario, seconds)
    groups = scenario.group_indices(num_characters)
    characters = [
        _first_character(scenario.groups[group], group, number, num_characters, phases, seed)
        for number, group in enumerate(groups)
    ]
    for group in range(len(scenario.groups)):
        characters += _arrivals(scenario, group, groups.count(group), len(characters), phases, seed)
    edits = [
        (at_s, plan.number, rule, value)
        for plan in characters
        for at_s, rule, value in _edits(scenario.groups[plan.group], plan, phases, seed)
    ]
    edits.sort()
    columns = np.array(edits, np.float64).reshape(-1, 4)
    return Schedule(
        phases,
        tuple(characters),
        columns[:, 0].copy(),
        columns[:, 1].astype(np.int64),
        columns[:, 2].astype(np.int64),
        columns[:, 3].astype(np.int64),
    )


def _generator(seed: int, *what: int) -> np.random.Generator:
    return np.random.default_rng([seed, *what])


def _first_character(
    group: Group, group_index: int, number: int, num_characters: int, phases: Phases, seed: int
) -> CharacterPlan:
    """A character that is present from the ramp on. Opens are spread evenly over the ramp, with a little jitter."""
    random = _generator(seed, 0, number)
    open_s = phases.ramp_s * (number + float(random.random())) / num_characters
    close_s = math.inf
    if group.life is not None:
        # In the steady state, those who are present have a length-biased life, part of which is already over.
        mu = math.log(group.life.median_s) + group.life.sigma**2
        close_s = phases.ramp_s + float(random.random() * random.lognormal(mu, group.life.sigma))
    return _character(group, group_index, number, phases, random, open_s=open_s, close_s=close_s)


def _arrivals(
    scenario: Scenario, group_index: int, num_alive: int, first_number: int, phases: Phases, seed: int
) -> list[CharacterPlan]:
    """Characters that come later, at the rate at which about num_alive are present at any time (Little's law)."""
    group = scenario.groups[group_index]
    if group.life is None or num_alive == 0:
        return []
    random = _generator(seed, 1, group_index)
    arrivals: list[CharacterPlan] = []
    open_s = phases.ramp_s
    while True:
        open_s += float(random.exponential(group.life.mean_s / num_alive))
        if open_s >= phases.measure_to_s:
            return arrivals
        close_s = open_s + float(random.lognormal(math.log(group.life.median_s), group.life.sigma))
        number = first_number + len(arrivals)
        arrivals.append(_character(group, group_index, number, phases, random, open_s=open_s, close_s=close_s))


def _character(
    group: Group,
    group_index: int,
    number: int,
    phases: Phases,
    random: np.random.Generator,
    *,
    open_s: float,
    close_s: float,
) -> CharacterPlan:
    return CharacterPlan(
        number,
        group_index,
        open_s,
        math.inf if close_s >= phases.end_s else close_s,
        int(random.integers(1, 1 << 53)),
        int(random.integers(len(group.prompts))),
    )


def _edits(group: Group, plan: CharacterPlan, phases: Phases, seed: int) -> list[tuple[float, int, int]]:
    """(at_s, rule, value) of one character's edits, from its open to its close."""
    found = []
    end_s = min(plan.close_s, phases.end_s)
    for index, rule in enumerate(group.edits):
        random = _generator(seed, 2, plan.number, index)
        prompt = plan.prompt
        for number, at_s in enumerate(_moments(rule, plan.open_s, end_s, random)):
            value = number
            if rule.kind == "prompt":  # not the one before: the same text would change nothing
                prompt = (prompt + 1 + int(random.integers(len(group.prompts) - 1))) % len(group.prompts)
                value = prompt
            found.append((at_s, index, value))
    return found


def _moments(rule: EditRule, open_s: float, end_s: float, random: np.random.Generator) -> list[float]:
    moments = []
    if rule.timing == "together":
        number = math.floor(open_s / rule.every_s - _TOGETHER_PHASE) + 1
        at_s = (number + _TOGETHER_PHASE) * rule.every_s
    else:
        at_s = open_s + rule.every_s * float(random.random() if rule.timing == "regular" else random.exponential())
    while at_s < end_s:
        moments.append(at_s)
        at_s += rule.every_s * (float(random.exponential()) if rule.timing == "random" else 1.0)
    return moments
