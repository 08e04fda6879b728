from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.model.diffusion import cosine_schedule

SCHEDULES = (1, 2, 3, 4, 5, 10)


def test_the_base_schedule_matches_the_golden_vectors(common_vectors: Any) -> None:
    vectors = common_vectors("diffusion")
    vectors.check_equal("base.out.alphas_cumprod", cosine_schedule(10).signal)


@pytest.mark.parametrize("num_steps", SCHEDULES)
def test_shortened_schedules_match_the_golden_vectors(common_vectors: Any, num_steps: int) -> None:
    vectors, schedule, case = common_vectors("diffusion"), cosine_schedule(10), f"n{num_steps}.out"
    used = slice(0, num_steps)
    assert schedule.base_step[num_steps, used].tolist() == vectors[f"{case}.use_timesteps"][used].tolist()
    assert torch.equal(schedule.remaining[num_steps, used], vectors[f"{case}.alphas_cumprod"][used])
    assert torch.equal(schedule.remaining_before[num_steps, used], vectors[f"{case}.alphas_cumprod_prev"][used])


@pytest.mark.parametrize("num_steps", SCHEDULES)
def test_reverse_steps_match_the_golden_vectors(common_vectors: Any, num_steps: int) -> None:
    vectors = common_vectors("diffusion")
    noisy, clean = vectors["step.in.x_t"], vectors["step.in.x_0"]
    moved = [
        cosine_schedule(10).reverse_step(noisy, clean, torch.full((2,), index), torch.full((2,), num_steps))
        for index in range(num_steps)
    ]
    vectors.check(f"n{num_steps}.out.x_prev", torch.stack(moved))


def test_every_row_has_its_own_step_and_schedule() -> None:
    schedule = cosine_schedule(10)
    noisy, clean = torch.randn(2, 4, 3, 5, generator=torch.Generator().manual_seed(0))
    index, num_steps = torch.tensor([3, 0, 9, 1]), torch.tensor([4, 1, 10, 5])
    together = schedule.reverse_step(noisy, clean, index, num_steps)
    for row in range(4):
        one = slice(row, row + 1)
        alone = schedule.reverse_step(noisy[one], clean[one], index[one], num_steps[one])
        assert torch.equal(together[one], alone)
    assert torch.equal(together[1], clean[1]), "the last step ends at the prediction"


@settings(deadline=None, max_examples=30)
@given(num_steps=st.integers(2, 10), seed=st.integers(0, 1000))
def test_a_perfect_prediction_keeps_the_noise(num_steps: int, seed: int) -> None:
    """With clean and noise known, a reverse step gives the same mixture at the next lower noise level."""
    schedule = cosine_schedule(10)
    clean, noise = torch.randn(2, 1, 2, 3, generator=torch.Generator().manual_seed(seed))
    for index in range(num_steps):
        given_, target = (table[num_steps, index].item() for table in (schedule.remaining, schedule.remaining_before))
        noisy = math.sqrt(given_) * clean + math.sqrt(1 - given_) * noise
        expected = math.sqrt(target) * clean + math.sqrt(1 - target) * noise
        moved = schedule.reverse_step(noisy, clean, torch.tensor([index]), torch.tensor([num_steps]))
        torch.testing.assert_close(moved, expected, atol=2e-5, rtol=0)


def test_added_noise_follows_the_cosine_schedule() -> None:
    schedule = cosine_schedule(10)
    clean, noise = torch.full((10, 1, 1), 3.0), torch.full((10, 1, 1), -1.0)
    noisy = schedule.add_noise(clean, noise, torch.arange(10)).flatten()
    levels = [math.cos(((i + 1) / 10 + 0.008) / 1.008 * math.pi / 2) ** 2 for i in range(9)]
    start = math.cos(0.008 / 1.008 * math.pi / 2) ** 2
    expected = [3 * math.sqrt(level / start) - math.sqrt(1 - level / start) for level in levels]
    assert noisy[:9].tolist() == pytest.approx(expected, abs=1e-5)


def test_a_schedule_without_steps_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1 step"):
        cosine_schedule(0)
