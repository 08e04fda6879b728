"""AdamAtan2, its schedule, and the moving average of weights."""

from __future__ import annotations

import pytest
import torch

from motiongen_ardy.train.moving_average import MovingAverage
from motiongen_ardy.train.optimizer import INNER_SCALE, AdamAtan2, warmup_cosine


def test_steps_follow_the_formula() -> None:
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(7, generator=generator)
    gradients = [torch.randn(7, generator=generator) for _ in range(4)]
    parameter = torch.nn.Parameter(start.clone())
    optimizer = AdamAtan2([parameter], lr=0.1, betas=(0.9, 0.99), weight_decay=0.01)
    expected, mean, square = start.double(), torch.zeros(7).double(), torch.zeros(7).double()
    for count, gradient in enumerate(gradients, 1):
        parameter.grad = gradient.clone()
        optimizer.step()
        mean = 0.9 * mean + 0.1 * gradient
        square = 0.99 * square + 0.01 * gradient.double() ** 2
        step = torch.atan2(mean / (1 - 0.9**count), (square / (1 - 0.99**count)).sqrt())
        expected = expected * (1 - 0.1 * 0.01) - 0.1 * INNER_SCALE * step
    torch.testing.assert_close(parameter.detach().double(), expected, atol=1e-6, rtol=0)


def test_steps_do_not_depend_on_the_scale_of_the_loss() -> None:
    results = []
    for scale in (1e-8, 1.0, 1e8):
        parameter = torch.nn.Parameter(torch.tensor([1.0, -2.0]))
        optimizer = AdamAtan2([parameter], lr=0.1)
        for _ in range(3):
            optimizer.zero_grad()
            (scale * parameter.square().sum()).backward()
            optimizer.step()
        results.append(parameter.detach())
    torch.testing.assert_close(results[0], results[1])
    torch.testing.assert_close(results[1], results[2])


def test_a_closure_is_refused() -> None:
    with pytest.raises(ValueError, match="closure"):
        AdamAtan2([torch.nn.Parameter(torch.zeros(1))], lr=0.1).step(lambda: 0.0)


def test_the_schedule_warms_up_and_ends_at_its_floor() -> None:
    factor = warmup_cosine(10, 100, floor=0.02)
    assert factor(0) == pytest.approx(0.1)
    assert factor(9) == pytest.approx(1.0)
    assert factor(55) == pytest.approx(0.51, abs=0.01)
    assert factor(100) == pytest.approx(0.02)
    assert factor(500) == pytest.approx(0.02)


def test_the_moving_average_forgets_the_untrained_weights() -> None:
    module = torch.nn.Linear(1, 1, bias=False)
    with torch.no_grad():
        module.weight.fill_(100.0)
    average = MovingAverage(module, 0.999)
    with torch.no_grad():
        module.weight.fill_(1.0)
    for _ in range(20):
        average.update(module, 5)
    assert float(average.module.weight.detach()) == pytest.approx(1.0, abs=1e-3)
    assert float(average.count) == 100


def test_a_moving_average_that_is_loaded_goes_on_as_if_it_had_never_been_saved() -> None:
    module = torch.nn.Linear(1, 1, bias=False)
    average = MovingAverage(module, 0.999)
    average.update(module, 100)
    loaded = MovingAverage(torch.nn.Linear(1, 1, bias=False), 0.999)
    loaded.load_state_dict(average.state_dict())
    torch.nn.init.constant_(module.weight, 5.0)
    for each in (average, loaded):
        each.update(module, 5)
    assert torch.equal(loaded.module.weight, average.module.weight)
    assert float(loaded.count) == 105


def test_a_learning_rate_may_be_a_tensor() -> None:
    results = []
    for rate in (0.1, torch.tensor(0.1)):
        parameter = torch.nn.Parameter(torch.tensor([1.0, -2.0]))
        optimizer = AdamAtan2([parameter], lr=rate)
        for _ in range(3):
            optimizer.zero_grad()
            parameter.square().sum().backward()
            optimizer.step()
        results.append(parameter.detach())
    torch.testing.assert_close(results[0], results[1])
