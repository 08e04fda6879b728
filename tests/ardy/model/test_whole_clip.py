from __future__ import annotations

from typing import Any

import torch

from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.generation import move_root
from motiongen_ardy.model.model import Model
from tests.ardy.model.whole_clip import WholeClip, append_window, clip_window, decode_clip, start_clip


def golden_clip(vectors: Any, case: str) -> WholeClip:
    crop = f"{case}.in.crop_history_length"
    return WholeClip(
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


def test_whole_clips_match_the_golden_vectors(golden: Any) -> None:
    vectors = golden.vectors("rollout_call")
    for case in vectors.cases:
        check_golden_clip(golden.model, vectors, case)


@torch.no_grad()
def check_golden_clip(model: Model, vectors: Any, case: str) -> None:
    clip = golden_clip(vectors, case)
    state = start_clip(model, clip)
    for index in range(len(clip.noise)):
        name = f"{case}.mid.window{index}"
        start, end, total = vectors[f"{name}.frames"].tolist()
        assert state.num_frames == end
        vectors.check(f"{name}.global_translation", state.translation)
        vectors.check(f"{name}.first_heading_angle", state.heading)
        window = clip_window(model, clip, state, index)
        assert window.window.num_frames == total - start
        horizon = vectors[f"{name}.hybrid"][:, : (end + model.config.horizon) // 4].shape[1]
        seen = window.tokens[:, : horizon - start // 4]
        vectors.check(f"{name}.hybrid", torch.cat([state.tokens[:, : start // 4], seen], dim=1))
        state = append_window(model, clip, state, window)
    world = move_root(model, state.tokens, state.translation)
    size = model.config.horizon // 4
    if clip.crop_frames is None:
        vectors.check(f"{case}.mid.decode0.hybrid", world)
    else:
        for index, first in enumerate(range(0, world.shape[1], size)):
            part = world[:, max(0, first - clip.crop_frames // 4) : first + size]
            vectors.check(f"{case}.mid.decode{index}.hybrid", part)
    if f"{case}.out.motion_normalized" in vectors:
        vectors.check(f"{case}.out.motion_normalized", decode_clip(model, clip, state)[:, : clip.num_frames])
