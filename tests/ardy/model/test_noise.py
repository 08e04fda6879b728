from __future__ import annotations

import pytest
import torch

from motiongen_ardy.model.noise import window_noise

PINNED = [1.0916891, 0.4558267, 0.7017897]


def test_noise_depends_only_on_seed_and_window_index() -> None:
    first = window_noise(7, 3, 10, 36)
    torch.manual_seed(0)
    assert torch.equal(window_noise(7, 3, 10, 36), first)
    assert not torch.equal(window_noise(8, 3, 10, 36), first)
    assert not torch.equal(window_noise(7, 4, 10, 36), first)
    assert not torch.equal(window_noise(3, 7, 10, 36), first), "seed and window are not interchangeable"


def test_noise_leaves_the_global_generator_alone() -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    window_noise(1, 1, 10, 36)
    assert torch.equal(torch.rand(3), expected)


def test_the_noise_of_a_seed_never_changes() -> None:
    """A session that is resumed on another machine must continue with the same noise."""
    assert window_noise(1, 0, 1, 3).flatten().tolist() == pytest.approx(PINNED, abs=1e-6)


def test_noise_is_standard_normal() -> None:
    noise = window_noise(2**64 - 1, 2**64 - 1, 500, 200)
    assert abs(float(noise.mean())) < 0.02
    assert float(noise.std()) == pytest.approx(1, abs=0.02)
    assert float((noise**4).mean()) == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize(("seed", "window_index"), [(-1, 0), (0, -1), (2**64, 0)])
def test_a_seed_or_window_index_outside_64_bits_is_refused(seed: int, window_index: int) -> None:
    with pytest.raises(ValueError, match="from 0 to 2\\^64 - 1"):
        window_noise(seed, window_index, 1, 1)
