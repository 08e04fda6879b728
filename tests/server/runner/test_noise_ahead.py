"""Noise made ahead of time is the noise that a window would start from anyway."""

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
def test_noise_is_that_of_the_plan_whatever_was_made_ahead(plans: list[tuple[int, int]]) -> None:
    noise = NoiseAhead(TOKENS, WIDTH)
    for seed, plan in plans:
        assert torch.equal(noise.of(seed, plan), window_noise(seed, plan - 1, TOKENS, WIDTH))
        noise.follow([(seed, plan)])


def test_noise_of_the_next_plans_is_made_ahead() -> None:
    noise = NoiseAhead(TOKENS, WIDTH)
    noise.follow([(7, 1), (8, 4)])
    until(lambda: made(noise) == 2)
    assert torch.equal(noise.of(8, 5), window_noise(8, 4, TOKENS, WIDTH))
    assert made(noise) == 1
    noise.of(7, 1)  # noise of an unforeseen plan is made at once
    assert made(noise) == 1


def test_oldest_unused_noise_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noise_ahead, "MOST_AHEAD", 4)
    noise = NoiseAhead(TOKENS, WIDTH)
    noise.follow([(seed, 1) for seed in range(10)])
    until(lambda: (9, 2) in noise._made and made(noise) == 4)
    assert [seed for seed, _ in noise._made] == [6, 7, 8, 9]
