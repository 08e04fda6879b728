"""Window requests: a tensor whose shape does not fit the others is refused by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from motiongen_ardy.model.generation import ROW_TENSORS, WindowRequest, start_window
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.window import WindowError


def request_of(model: Model) -> WindowRequest:
    """Two rows with everything that a window can be given."""
    config, features = model.config, model.representation.feature_dim
    history, frames = 2 * config.patch, 2 * config.patch + config.horizon
    observed, mask = torch.zeros(2, frames, features), torch.zeros(2, frames, features)
    return WindowRequest(
        num_frames=frames,
        num_steps=1,
        text=torch.zeros(2, 1, config.denoiser.text_dim),
        noise=torch.zeros(2, config.horizon_tokens, config.token_width),
        history=torch.zeros(2, history, features),
        history_tokens=torch.zeros(2, 2, config.token_width),
        translation=torch.zeros(2, 3),
        heading=torch.zeros(2),
        observed=observed,
        mask=mask,
        planned=torch.zeros(2, frames, 2, dtype=torch.bool),
    )


CHANGES: dict[str, Callable[[Tensor], Tensor]] = {
    "a row more": lambda values: torch.cat([values, values[:1]]),
    "narrower": lambda values: values[..., :-1],
    "a dimension more": lambda values: values[None],
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", ROW_TENSORS)
def test_a_tensor_whose_shape_does_not_fit_is_refused_by_name(golden: Any, name: str, change: str) -> None:
    request = request_of(golden.model)
    assert start_window(golden.model, request).tokens.shape[0] == 2
    changed = CHANGES[change](getattr(request, name))
    # The text gives the number of rows: if it has one more, all other tensors have one too few.
    said = "noise" if (name, change) == ("text", "a row more") else name
    with pytest.raises(WindowError, match=rf"{said} has shape \("):
        start_window(golden.model, replace(request, **{name: changed}))


@pytest.mark.parametrize("name", ["observed", "mask", "planned"])
def test_goals_of_too_few_or_too_many_frames_are_refused(golden: Any, name: str) -> None:
    request = request_of(golden.model)
    for changed in (getattr(request, name)[:, :-4], getattr(request, name).repeat(1, 2, 1)):
        with pytest.raises(WindowError, match=f"{name} has shape .* is wanted"):
            start_window(golden.model, replace(request, **{name: changed}))


def test_a_window_without_a_horizon_is_refused(golden: Any) -> None:
    request = request_of(golden.model)
    with pytest.raises(WindowError, match="noise has no token"):
        start_window(golden.model, replace(request, noise=request.noise[:, :0]))
