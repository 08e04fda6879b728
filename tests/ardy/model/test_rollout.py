from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.generation import (
    WindowRequest,
    WindowState,
    denoise_step,
    denoise_window,
    finish_window,
    start_window,
    world_tokens,
)
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.noise import window_noise
from motiongen_ardy.model.rollout import RolloutRequest, rollout, visible_frames
from motiongen_ardy.model.window import WindowError

WINDOWS = (
    ("window_first", "plain"),
    ("window_first", "constrained"),
    ("window_next", "full"),
    ("window_next", "short"),
)


def golden_request(vectors: Any, case: str) -> WindowRequest:
    weight = vectors[f"{case}.in.cfg_weight"].tolist()
    return WindowRequest(
        num_frames=vectors.number(f"{case}.in.num_frames"),
        num_steps=vectors.number(f"{case}.in.num_denoising_steps"),
        text=vectors[f"{case}.in.text_feat"],
        noise=vectors[f"{case}.in.noise"],
        weights=GuidanceWeights(*weight) if len(weight) == 2 else GuidanceWeights(weight[0], 0.0),
        history=vectors.get(f"{case}.in.history_normalized"),
        translation=vectors.get(f"{case}.in.global_translation"),
        heading=vectors.get(f"{case}.in.first_heading_angle"),
        observed=vectors.get(f"{case}.in.observed_motion"),
        mask=vectors.get(f"{case}.in.motion_mask"),
    )


@pytest.mark.parametrize(("file", "case"), WINDOWS)
def test_windows_match_the_golden_vectors(golden: Any, file: str, case: str) -> None:
    vectors, model = golden.vectors(file), golden.model
    request = golden_request(vectors, case)
    after: list[Tensor] = []
    with torch.no_grad():
        state = first = start_window(model, request)
        for index in reversed(range(request.num_steps)):
            state = denoise_step(model, state, index, request.num_steps)
            after.append(state.tokens)
        vectors.check(f"{case}.mid.global_translation", state.translation)
        vectors.check(f"{case}.mid.first_heading_angle", state.window.heading)
        vectors.check(f"{case}.mid.x_after_step", torch.stack(after))
        known = vectors[f"{case}.mid.window_hybrid"].shape[1]
        vectors.check(f"{case}.mid.window_hybrid", state.tokens[:, :known])
        vectors.check(f"{case}.mid.decoded_hybrid", world_tokens(model, state))
        features = finish_window(model, state)
    vectors.check(f"{case}.out.motion_normalized", features)
    layout = model.representation
    vectors.check(f"{case}.out.posed_joints", layout.positions(layout.denormalize(features)))
    check_denoiser_input(vectors, case, first)


def check_denoiser_input(vectors: Any, case: str, state: WindowState) -> None:
    """Check what the denoiser was given, for the cases that recorded it."""
    if f"{case}.mid.denoiser_motion_mask" not in vectors:
        return
    vectors.check_equal(f"{case}.mid.denoiser_motion_mask", state.window.mask)
    vectors.check(f"{case}.mid.denoiser_observed_motion", state.window.observed)
    vectors.check_equal(f"{case}.mid.denoiser_history_token_mask", state.window.history_tokens)
    vectors.check_equal(f"{case}.mid.denoiser_generation_token_mask", state.window.generation_tokens)
    vectors.check_equal(f"{case}.mid.denoiser_future_token_mask", state.window.future_tokens)


def test_consecutive_windows_match_the_golden_vectors(golden: Any) -> None:
    """Each window re-encodes the last frames of the one before; a goal moves from the future into the horizon."""
    vectors, model = golden.vectors("rollout_steps"), golden.model
    targets = Targets(model.skeleton)
    targets.add_waypoints([vectors.number("in.goal_frame")], vectors["in.goal_root_2d"], vectors["in.goal_heading"])
    features = torch.zeros(0, model.representation.feature_dim)
    history_frames = vectors.number("in.history_frames")
    for index, (start, end, span) in enumerate(vectors["mid.frames"].tolist()):
        history = features[max(0, end - history_frames) :]
        assert visible_frames(model, len(history), targets, start) == span
        observed, mask = targets.observe(model.representation, start, span)
        request = WindowRequest(
            num_frames=span,
            num_steps=vectors.number("in.num_denoising_steps"),
            text=vectors["in.text_feat"][index],
            noise=vectors["in.noise"][index],
            weights=GuidanceWeights(*vectors["in.cfg_weight"].tolist()),
            history=history[None] if len(history) else None,
            heading=vectors["in.first_heading_angle"],
            observed=observed[None],
            mask=mask[None],
        )
        with torch.no_grad():
            state = start_window(model, request)
            vectors.check(f"mid.window{index}.global_translation", state.translation)
            vectors.check(f"mid.window{index}.first_heading_angle", state.window.heading)
            for step in reversed(range(request.num_steps)):
                state = denoise_step(model, state, step, request.num_steps)
            known = vectors[f"mid.window{index}.hybrid"].shape[1]
            vectors.check(f"mid.window{index}.hybrid", state.tokens[:, :known])
            features = torch.cat([features, finish_window(model, state)[0, len(history) :]])
    vectors.check("out.motion_normalized", features[None])


def text_of(model: Model, seed: int = 0) -> Tensor:
    return torch.randn(model.config.denoiser.text_dim, generator=torch.Generator().manual_seed(seed))


def test_a_rollout_equals_its_windows_generated_one_by_one(golden: Any) -> None:
    model, horizon = golden.model, golden.model.config.horizon
    request = RolloutRequest(2 * horizon, text_of(model), seed=3, num_steps=2, history_frames=8, start=(1.0, -2.0, 0.5))
    result = rollout(model, request)
    width = model.config.token_width

    def window(index: int, **given: Any) -> Tensor:
        noise = window_noise(3, index, horizon // 4, width)[None]
        request = WindowRequest(text=text_of(model)[None, None], noise=noise, num_steps=2, **given)
        return finish_window(model, denoise_window(model, request))

    first = window(0, num_frames=horizon, translation=torch.tensor([[1.0, 0.0, -2.0]]), heading=torch.tensor([0.5]))
    second = window(1, num_frames=horizon + 8, history=first[:, -8:])
    assert torch.equal(result, torch.cat([first[0], second[0, 8:]]))


def test_a_shorter_rollout_is_the_beginning_of_a_longer_one(golden: Any) -> None:
    request = RolloutRequest(50, text_of(golden.model), seed=1, num_steps=2)
    longer = rollout(golden.model, request)
    assert longer.shape == (50, golden.model.representation.feature_dim)
    assert torch.equal(rollout(golden.model, replace(request, num_frames=30)), longer[:30])
    assert longer.isfinite().all()
    assert not torch.equal(rollout(golden.model, replace(request, num_frames=30, seed=2)), longer[:30])


def test_a_later_prompt_changes_nothing_before_it(golden: Any) -> None:
    request = RolloutRequest(60, text_of(golden.model), seed=1, num_steps=2)
    plain = rollout(golden.model, request)
    changed = rollout(golden.model, replace(request, later_text=((22, text_of(golden.model, 1)),)))
    assert len(changed) == 60
    assert torch.equal(changed[:22], plain[:22])
    assert not torch.equal(changed[22:40], plain[22:40])


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_a_start_elsewhere_with_the_same_heading_gives_the_same_motion_moved_over_the_ground(
    golden: Any, heading: float
) -> None:
    model, layout = golden.model, golden.model.representation

    def motion(*start: float) -> Tensor:
        request = RolloutRequest(model.config.horizon, text_of(model), num_steps=2, start=start)
        return layout.denormalize(rollout(model, request))

    expected = layout.translate_ground(motion(0.0, 0.0, heading)[None], torch.tensor([[3.0, -1.0]]))[0]
    torch.testing.assert_close(motion(3.0, -1.0, heading), expected, atol=1e-4, rtol=0)
    assert not torch.allclose(motion(0.0, 0.0, heading + 1.0), motion(0.0, 0.0, heading), atol=1e-2)


def test_goals_move_with_the_character(golden: Any) -> None:
    """A goal is seen relative to where the window starts."""
    model, layout = golden.model, golden.model.representation

    def walk(x: float, z: float) -> Tensor:
        targets = Targets(model.skeleton)
        targets.add_waypoints([30, 70], torch.tensor([[x + 1.0, z + 2.0], [x - 1.0, z + 3.0]]))
        request = RolloutRequest(80, text_of(model), num_steps=2, targets=targets, start=(x, z, 0.0))
        return layout.denormalize(rollout(model, request))

    expected = layout.translate_ground(walk(0.0, 0.0)[None], torch.tensor([[4.0, -6.0]]))[0]
    torch.testing.assert_close(walk(4.0, -6.0), expected, atol=1e-3, rtol=0)


def test_a_window_extends_to_the_goals_in_sight(golden: Any) -> None:
    model = golden.model
    horizon, longest = model.config.horizon, model.config.max_window_frames
    assert visible_frames(model, 8, None, 100) == horizon + 8

    def span(*frames: int) -> int:
        targets = Targets(model.skeleton)
        targets.add_waypoints(list(frames), torch.zeros(len(frames), 2))
        return visible_frames(model, 8, targets, 100)

    assert span(107) == horizon + 8, "a goal in the history is no reason to extend it"
    assert span(110) == horizon + 8
    assert span(100 + horizon + 8) == horizon + 12
    assert span(110, 100 + horizon + 17) == horizon + 20
    assert span(99 + longest) == longest
    assert span(100 + longest) == horizon + 8, "a goal too far ahead is not in sight yet"
    assert span(110, 100_000) == horizon + 8


@pytest.mark.parametrize("history_frames", [0, 6, -4])
def test_invalid_numbers_of_history_frames_are_refused(golden: Any, history_frames: int) -> None:
    with pytest.raises(WindowError, match="multiple of 4"):
        rollout(golden.model, RolloutRequest(8, text_of(golden.model), history_frames=history_frames))


@pytest.mark.parametrize("frames", [[3], [0], [8, 8], [12, 8]])
def test_later_prompts_out_of_order_are_refused(golden: Any, frames: list[int]) -> None:
    text = text_of(golden.model)
    with pytest.raises(WindowError, match="must rise"):
        rollout(golden.model, RolloutRequest(80, text, later_text=tuple((frame, text) for frame in frames)))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"num_steps": 0}, "takes 1 to 10"),
        ({"num_steps": 11}, "takes 1 to 10"),
        ({"num_frames": 8}, "history and horizon alone need"),
        ({"num_frames": 90}, "multiple of 4"),
        ({"num_frames": 40_000}, "at most"),
    ],
)
def test_an_invalid_window_request_is_refused(golden: Any, given: dict[str, Any], message: str) -> None:
    request = replace(golden_request(golden.vectors("window_first"), "plain"), **given)
    with pytest.raises(WindowError, match=message):
        start_window(golden.model, request)


def test_a_history_that_is_not_whole_tokens_is_refused(golden: Any) -> None:
    request = golden_request(golden.vectors("window_next"), "short")
    with pytest.raises(WindowError, match="history has 3 frames"):
        start_window(golden.model, replace(request, history=request.history[:, 1:]))
