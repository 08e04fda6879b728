from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from motiongen_ardy.model.clip import ClipRequest, append_window, clip_window, decode_clip, generate_clip, start_clip
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import WindowRequest, move_root, start_window
from motiongen_ardy.model.window import WindowError


def golden_request(vectors: Any, case: str) -> ClipRequest:
    crop = f"{case}.in.crop_history_length"
    return ClipRequest(
        num_frames=vectors.number(f"{case}.in.num_frames"),
        num_steps=vectors.number(f"{case}.in.num_denoising_steps"),
        text=vectors[f"{case}.in.text_feat"],
        noise=vectors[f"{case}.in.noise"],
        heading=vectors[f"{case}.in.first_heading_angle"],
        weights=GuidanceWeights(*vectors[f"{case}.in.cfg_weight"].tolist()),
        observed=vectors.get(f"{case}.in.observed_motion"),
        mask=vectors.get(f"{case}.in.motion_mask"),
        crop_frames=vectors.number(crop) if crop in vectors else None,
    )


def test_golden_clips(golden: Any) -> None:
    vectors = golden.vectors("rollout_call")
    for case in vectors.cases:
        check_golden_clip(golden.model, vectors, case)


def check_golden_clip(model: Model, vectors: Any, case: str) -> None:
    request = golden_request(vectors, case)
    with torch.no_grad():
        state = start_clip(model, request)
        for index in range(len(request.noise)):
            name = f"{case}.mid.window{index}"
            start, end, total = vectors[f"{name}.frames"].tolist()
            assert state.num_frames == end
            vectors.check(f"{name}.global_translation", state.translation)
            vectors.check(f"{name}.first_heading_angle", state.heading)
            window = clip_window(model, request, state, index)
            assert window.window.num_frames == total - start
            horizon = vectors[f"{name}.hybrid"][:, : (end + model.config.horizon) // 4].shape[1]
            seen = window.tokens[:, : horizon - start // 4]
            vectors.check(f"{name}.hybrid", torch.cat([state.tokens[:, : start // 4], seen], dim=1))
            state = append_window(model, request, state, window)
        decoded = decode_clip(model, request, state)[:, : request.num_frames]
    world = move_root(model.representation, state.tokens, state.translation)
    size = model.config.horizon // 4
    if request.crop_frames is None:
        vectors.check(f"{case}.mid.decode0.hybrid", world)
    else:
        for index, first in enumerate(range(0, world.shape[1], size)):
            part = world[:, max(0, first - request.crop_frames // 4) : first + size]
            vectors.check(f"{case}.mid.decode{index}.hybrid", part)
    if f"{case}.out.motion_normalized" in vectors:
        vectors.check(f"{case}.out.motion_normalized", decoded)
    assert torch.equal(generate_clip(model, request), decoded)


def test_a_clip_goes_on_from_a_history(golden: Any) -> None:
    """The first window after a history is the window that `start_window` lays out for it."""
    vectors, model = golden.vectors("window_next"), golden.model
    history, horizon = vectors["full.in.history_normalized"], model.config.horizon
    noise = vectors["full.in.noise"]
    request = ClipRequest(
        8 + 2 * horizon, 2, vectors["full.in.text_feat"], torch.stack([noise, noise]), history=history
    )
    window_request = WindowRequest(8 + 2 * horizon, 2, request.text, noise, history=history)
    with torch.no_grad():
        state, expected = start_clip(model, request), start_window(model, window_request)
        torch.testing.assert_close(state.translation, expected.translation)
        torch.testing.assert_close(state.heading, expected.window.heading)
        torch.testing.assert_close(state.tokens, expected.tokens[:, :2])
        clip = generate_clip(model, request)
    assert clip.shape[:2] == (2, 8 + 2 * horizon)
    layout = model.representation
    root = slice(0, 3)
    kept, given = (layout.denormalize(part)[..., root] for part in (clip[:, :8], history))
    torch.testing.assert_close(kept, given, atol=1e-4, rtol=0)


def test_rows_may_end_earlier(golden: Any) -> None:
    """A row's own frames are those of a clip that is requested at its length."""
    vectors, model = golden.vectors("rollout_call"), golden.model
    request = replace(golden_request(vectors, "cropped"), crop_frames=None, observed=None, mask=None)
    ends = [request.num_frames - 9, request.num_frames]
    both = replace(
        request,
        text=request.text.repeat(2, 1, 1),
        noise=request.noise.repeat(1, 2, 1, 1),
        heading=request.heading.repeat(2),
        lengths=torch.tensor(ends),
    )
    clip = generate_clip(model, both)
    shorter = generate_clip(model, replace(request, num_frames=ends[0]))
    torch.testing.assert_close(clip[:1, : ends[0]], shorter, atol=1e-4, rtol=0)
    torch.testing.assert_close(clip[1:], generate_clip(model, request), atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"heading": None}, "a heading or with a history"),
        ({"history": torch.zeros(1, 8, 330)}, "a heading or with a history"),
        ({"heading": None, "history": torch.zeros(1, 8, 330)}, "leave out crop_frames"),
        ({"crop_frames": 6}, "crop_frames is 6 frames"),
        ({"heading": None, "history": torch.zeros(1, 6, 330), "crop_frames": None}, "history is 6 frames"),
    ],
)
def test_a_contradictory_clip_is_refused(golden: Any, given: dict[str, Any], message: str) -> None:
    request = golden_request(golden.vectors("rollout_call"), "cropped")
    with pytest.raises(WindowError, match=message):
        replace(request, **given)


@pytest.mark.parametrize("num_windows", [0, 2, 4])
def test_noise_must_fit_the_length(golden: Any, num_windows: int) -> None:
    num_frames = max(0, num_windows * golden.model.config.horizon - 1)
    request = replace(golden_request(golden.vectors("rollout_call"), "cropped"), num_frames=num_frames)
    with pytest.raises(WindowError, match="noise is for 3 windows"):
        generate_clip(golden.model, request)
