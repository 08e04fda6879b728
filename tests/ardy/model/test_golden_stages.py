"""Intermediate results: every array of the golden files that other tests do not check."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import ROOT_WIDTH, heading_angle
from motiongen_ardy.core.skeleton import forward_kinematics
from motiongen_ardy.model.diffusion import cosine_schedule
from motiongen_ardy.model.generation import denoise_step, start_window
from motiongen_ardy.model.tokenizer import Tokenizer
from motiongen_ardy.model.tokenizer.model import valid_tokens
from tests.ardy.conftest import GoldenModel, Vectors
from tests.ardy.model.test_denoiser import CASES
from tests.ardy.model.test_rollout import golden_request


class Recorder:
    """Records, for each module, the first input and the output of its latest call."""

    def __init__(self, **modules: nn.Module) -> None:
        self.given: dict[str, Tensor] = {}
        self.results: dict[str, Tensor] = {}
        self._hooks = [self._watch(name, module) for name, module in modules.items()]

    def _watch(self, name: str, module: nn.Module) -> Any:
        def hook(_: nn.Module, given: tuple[Tensor, ...], result: Tensor) -> None:
            self.given[name], self.results[name] = given[0], result

        return module.register_forward_hook(hook)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        for hook in self._hooks:
            hook.remove()


@pytest.mark.parametrize("file", ["denoiser_cases", "denoiser_stages", "guidance"])
def test_masks_of_frames_and_tokens_follow_from_lengths(golden: GoldenModel, file: str) -> None:
    vectors = golden.vectors(file)
    for case in [f"{name}." for name in CASES] if file == "denoiser_cases" else [""]:
        window = vectors.window(case)
        for part in ("history", "generation", "future"):
            vectors.check_equal(f"{case}in.{part}_mask", getattr(window, f"{part}_frames"))
            vectors.check_equal(f"{case}in.{part}_token_mask", getattr(window, f"{part}_tokens"))


@pytest.mark.parametrize("stage", ["root", "body"])
def test_intermediate_results_of_a_stage(golden: GoldenModel, stage: str) -> None:
    vectors, denoiser = golden.vectors("denoiser_stages"), golden.model.denoiser
    window, model = vectors.window(), getattr(denoiser, f"{stage}_model")
    kind = "global" if stage == "root" else "local"
    modules = {
        "text": model.embed_text,
        "time": model.embed_timestep,
        "heading": model.linear_first_heading_angle,
        "generation": getattr(denoiser, f"{kind}_root_hybrid_constraints_proj"),
        "history": getattr(denoiser, f"{kind}_root_hybrid_proj"),
        "transformer": model.seqTransEncoder,
    }
    with Recorder(**modules) as seen, torch.no_grad():
        denoiser(vectors["in.x"], vectors["in.timesteps"], window)
    prefix = f"mid.{stage}_"
    visible = denoiser.visible(window)
    vectors.check(f"{prefix}text_token", seen.results["text"])
    vectors.check(f"{prefix}time_token", seen.results["time"])
    vectors.check(f"{prefix}heading_token", seen.results["heading"])
    vectors.check(f"{prefix}generation_proj", seen.results["generation"], where=window.generation_tokens)
    vectors.check(f"{prefix}history_proj", seen.results["history"], where=window.history_tokens)
    sequence = seen.given["transformer"]
    vectors.check(f"{prefix}motion_tokens", sequence[:, 3:], where=visible)
    everything = torch.cat([torch.ones(len(visible), 3, dtype=torch.bool), visible], dim=1)
    vectors.check(f"{prefix}sequence", sequence, where=everything)
    vectors.check_equal(f"{prefix}stage_mask", visible)
    vectors.check_equal(f"{prefix}token_index", window.token_positions)
    if stage == "root":
        head = vectors["mid.root_generation_input_head"].shape[-1]
        given = seen.given["generation"][..., :head]
        vectors.check("mid.root_generation_input_head", given, where=window.generation_tokens)
    else:
        vectors.check("mid.body_history_input", seen.given["history"], where=window.history_tokens)


def tokenizer_of(golden: GoldenModel) -> Tokenizer:
    assert golden.model.tokenizer is not None
    return golden.model.tokenizer


def test_intermediate_results_of_the_tokenizer(golden: GoldenModel) -> None:
    tokenizer, vectors = tokenizer_of(golden), golden.vectors("tokenizer")
    valid, kept = vectors["in.pad_mask"], vectors["out.token_mask"]
    with Recorder(encoder=tokenizer.encoder.seqTransEncoder) as seen, torch.no_grad():
        tokenizer.encode(vectors["in.motion_normalized"], valid)
    vectors.check("mid.encoder_with_position", seen.given["encoder"], where=kept)
    decoder = tokenizer.decoder
    modules = {"latent": decoder.input_proj, "joined": decoder.external_cond_blocks[0]}
    with Recorder(transformer=decoder.seqTransEncoder, **modules) as seen, torch.no_grad():
        codes = tokenizer.codes(vectors["decode.in.latent"])
        decoder(codes, vectors["decode.in.external_cond"], valid_tokens(valid, 4))
    vectors.check("decode.mid.decoder_latent_proj", seen.results["latent"])
    vectors.check("decode.mid.decoder_conditioned", seen.results["joined"].relu())
    vectors.check("decode.mid.decoder_with_position", seen.given["transformer"])
    vectors.check("decode.mid.decoder_transformer", seen.results["transformer"], where=kept)
    rows = golden.vectors("positional")
    expected = rows["const.tokenizer_position_rows"]
    assert torch.equal(tokenizer.encoder.positions(torch.arange(len(expected))), expected)


def test_statistics_match_the_golden_vectors(golden: GoldenModel) -> None:
    vectors, layout, tokenizer = golden.vectors("normalization"), golden.model.representation, tokenizer_of(golden)
    features = layout.feature_stats
    for name, mean, scale in (
        ("global_root_stats", layout.root_stats.mean, layout.root_stats.scale),
        ("local_root_stats", layout.local_root_stats.mean, layout.local_root_stats.scale),
        ("post_quantization_stats", tokenizer.post_stats.mean, tokenizer.post_stats.scale),
        ("pre_quantization_stats", tokenizer.pre_stats.mean, tokenizer.pre_stats.scale),
        ("stats", features.mean, features.scale),
    ):
        vectors.check(f"const.{name}.mean", mean)
        vectors.check(f"const.{name}.std_eps", scale)


def test_intermediate_results_of_features(golden: GoldenModel) -> None:
    layout, vectors = golden.model.representation, golden.vectors("features")
    rotations, positions = forward_kinematics(
        layout.skeleton, vectors["in.local_rot_mats"], vectors["in.root_positions"]
    )
    vectors.check("out.global_rot_mats", rotations)
    vectors.check("out.posed_joints", positions)
    vectors.check("out.heading_angle", heading_angle(layout.skeleton, positions))
    features = vectors["inverse.in.features"]
    vectors.check("inverse.out.global_rot_mats", layout.global_rotations(features))
    vectors.check("inverse.out.root_positions", layout.motion(features).root_positions)
    vectors.check("inverse.out.global_root_heading", features[..., 3:ROOT_WIDTH])


def test_positions_relative_to_the_root(golden: GoldenModel) -> None:
    vectors = golden.vectors("kinematics")
    _, positions = forward_kinematics(
        golden.model.skeleton, vectors["in.local_rot_mats"], torch.zeros_like(vectors["in.root_positions"])
    )
    vectors.check("out.posed_joints_from_root", positions)


def test_the_root_in_natural_units(golden: GoldenModel) -> None:
    layout, vectors = golden.model.representation, golden.vectors("root")
    root, lengths = vectors["in.root_normalized"], vectors["in.lengths"]
    vectors.check("out.root_unnormalized", layout.root_stats.denormalize(root))
    local = layout.local_root(root, lengths)
    vectors.check("out.local_root_unnormalized", layout.local_root_stats.denormalize(local))
    whole = layout.local_root(root, torch.full_like(lengths, root.shape[1]))
    vectors.check("out.local_root_normalized_full_length", whole)
    canonical = [layout.canonicalize(row[None]) for row in vectors["in.features"]]
    vectors.check("out.canonical", torch.cat(canonical))


@pytest.mark.parametrize(
    ("file", "case"), [("window_first", "plain"), ("window_next", "full"), ("window_next", "short")]
)
def test_clean_predictions_of_every_step(golden: GoldenModel, file: str, case: str) -> None:
    """The prediction follows from a step's input and result; the last step's result is the prediction itself."""
    vectors, model = golden.vectors(file), golden.model
    request = golden_request(vectors, case)
    schedule, predictions = cosine_schedule(model.config.num_base_steps), []
    with torch.no_grad():
        state = start_window(model, request)
        for index in reversed(range(request.num_steps)):
            moved = denoise_step(model, state, index, request.num_steps)
            given = schedule.remaining[request.num_steps, index].double()
            target = schedule.remaining_before[request.num_steps, index].double()
            share = ((1 - target) / (1 - given)).sqrt()
            clean = (moved.tokens.double() - share * state.tokens) / (target.sqrt() - share * given.sqrt())
            predictions.append(torch.where(state.window.generation_tokens[..., None], clean.float(), state.tokens))
            state = moved
    expected = vectors[f"{case}.mid.clean_prediction"]
    generated = state.window.generation_tokens[None, ..., None].expand_as(expected)
    vectors.check(f"{case}.mid.clean_prediction", torch.stack(predictions), where=generated)


def test_each_pass_of_the_first_step(golden: GoldenModel) -> None:
    """The passes with text only, with constraints only and with neither, at the noisiest base step."""
    vectors, model = golden.vectors("window_next"), golden.model
    request = golden_request(vectors, "full")
    schedule = cosine_schedule(model.config.num_base_steps)
    with torch.no_grad():
        state = start_window(model, request)
        step = schedule.base_step[request.num_steps, request.num_steps - 1].expand(len(state.tokens))
        told = (state.window.without_constraints(), state.window.without_text())
        windows = (*told, told[0].without_text())
        passes = torch.cat([model.denoiser(state.tokens, step, window) for window in windows])
    assert torch.equal(step, vectors["full.mid.denoiser_timesteps"])
    generated = state.window.generation_tokens.repeat(3, 1)[..., None].expand_as(passes)
    vectors.check("full.mid.first_step_passes", passes, where=generated)


@pytest.mark.parametrize("case", ["full", "short"])
def test_history_is_encoded_and_recentred(golden: GoldenModel, case: str) -> None:
    vectors = golden.vectors("window_next")
    with torch.no_grad():
        state = start_window(golden.model, golden_request(vectors, case))
    expected = vectors[f"{case}.mid.history_hybrid_recentred"]
    assert expected.shape[-1] > 20
    vectors.check(f"{case}.mid.history_hybrid_recentred", state.tokens[:, : expected.shape[1]])


@pytest.mark.parametrize("num_steps", [1, 2, 3, 4, 5, 10])
def test_schedules_match_the_golden_square_roots(common_vectors: Callable[[str], Vectors], num_steps: int) -> None:
    """The reference stores tables of square roots; ours hold variances."""
    vectors, schedule, case = common_vectors("diffusion"), cosine_schedule(10), f"n{num_steps}.out"
    kept = schedule.remaining[num_steps, :num_steps].double()
    for name, ours in (
        ("sqrt_alphas_cumprod", kept.sqrt()),
        ("sqrt_one_minus_alphas_cumprod", (1 - kept).sqrt()),
        ("sqrt_recip_alphas_cumprod", kept.rsqrt()),
        ("sqrt_recipm1_alphas_cumprod", (1 / kept - 1).sqrt()),
    ):
        torch.testing.assert_close(vectors[f"{case}.{name}"][:num_steps].double(), ours, rtol=1e-5, atol=1e-6)
    before = schedule.remaining_before[num_steps, :num_steps].double()
    torch.testing.assert_close(vectors[f"{case}.betas"][:num_steps].double(), 1 - kept / before, rtol=1e-4, atol=1e-6)
