"""Noise that is made ahead is the noise that a window starts from."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.model.noise import window_noise
from motiongen_server.runner import noise_ahead
from motiongen_server.runner.noise_ahead import NoiseAhead
from tests.waiting import until

TOKENS, WIDTH = 3, 5
PLANS = st.lists(st.tuples(st.integers(0, 3), st.integers(1, 4)), max_size=12)


def made(noise: NoiseAhead) -> int:
    return len(noise._made)


@given(PLANS)
def test_it_is_that_of_the_plan_whatever_was_made_ahead(plans: list[tuple[int, int]]) -> None:
    noise = NoiseAhead(TOKENS, WIDTH)
    for seed, plan in plans:
        assert torch.equal(noise.of(seed, plan), window_noise(seed, plan - 1, TOKENS, WIDTH))
        noise.follow([(seed, plan)])


def test_the_next_plans_are_there_when_they_are_asked_for() -> None:
    noise = NoiseAhead(TOKENS, WIDTH)
    noise.follow([(7, 1), (8, 4)])
    until(lambda: made(noise) == 2)
    assert torch.equal(noise.of(8, 5), window_noise(8, 4, TOKENS, WIDTH))
    assert made(noise) == 1
    noise.of(7, 1)  # a plan that nobody foresaw is made at once
    assert made(noise) == 1


def test_what_nobody_asks_for_is_let_go_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noise_ahead, "MOST_AHEAD", 4)
    noise = NoiseAhead(TOKENS, WIDTH)
    noise.follow([(seed, 1) for seed in range(10)])
    until(lambda: (9, 2) in noise._made and made(noise) == 4)
    assert [seed for seed, _ in noise._made] == [6, 7, 8, 9]
