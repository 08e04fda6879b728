from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import DenoiserConfig, TransformerConfig
from motiongen_ardy.model.denoiser import TwoStageDenoiser, build_denoiser
from motiongen_ardy.model.window import Window

CASES = ("no_history", "history", "constraints_in_window", "constraints_in_future", "mixed_history", "zero_text")
VARIANTS = {
    "two stages": {},
    "one stage": {"num_stages": 1},
    "no goals": {"constraints": False},
    "plain positions": {"positions": "default"},
    "no heading": {"heading_token": False},
    "masked text": {"use_text_mask": True, "text_tokens": 3},
}
ROOT_NUMBERS = 20  # of a token of four frames


@pytest.mark.parametrize("case", CASES)
def test_predictions_match_the_golden_cases(golden: Any, case: str) -> None:
    vectors = golden.vectors("denoiser_cases")
    with torch.no_grad():
        hybrid = golden.model.denoiser(
            vectors[f"{case}.in.x"], vectors[f"{case}.in.timesteps"], vectors.window(f"{case}.")
        )
    vectors.check(f"{case}.out.hybrid", hybrid)


def test_every_stage_matches_the_golden_vectors(golden: Any) -> None:
    """Every intermediate result of one call; stages are checked where a token is visible."""
    vectors, denoiser = golden.vectors("denoiser_stages"), golden.model.denoiser
    window, tokens, step = vectors.window(), vectors["in.x"], vectors["in.timesteps"]
    layers: dict[str, Tensor] = {}
    hooks = []
    for stage in ("root", "body"):
        model = getattr(denoiser, f"{stage}_model")
        for index, layer in enumerate(model.seqTransEncoder.layers):
            hooks.append(layer.register_forward_hook(record(layers, f"mid.{stage}_layer{index}")))
        hooks.append(model.output_linear.register_forward_hook(record(layers, f"mid.{stage}_head")))
        layers[f"mid.{stage}_prefix"] = model.prefix(window, step)
    with torch.no_grad():
        goals = denoiser.goals(window)
        inputs, ahead = denoiser.hybrid_inputs(tokens, goals, window)
        hybrid = denoiser(tokens, step, window)
        for hook in hooks:
            hook.remove()
        root = hybrid[..., :ROOT_NUMBERS]
        local_inputs = denoiser.local_inputs(tokens, root, goals, ahead, window)
    vectors.check("mid.future_proj", ahead, where=window.future_tokens)
    vectors.check("mid.root_stage_input", inputs)
    vectors.check("mid.body_stage_input", local_inputs)
    vectors.check("out.hybrid", hybrid)
    visible = denoiser.visible(window)
    vectors.check_equal("mid.root_stage_mask", visible)
    vectors.check_equal("mid.root_token_index", window.token_positions)
    whole = torch.cat([torch.ones(len(visible), 3, dtype=torch.bool), visible], dim=1)
    for name, actual in layers.items():
        where = None if "prefix" in name else visible if "head" in name else whole
        vectors.check(name, actual, where=where)
    assert sum("layer" in name for name in layers) == 2 * denoiser.config.transformer.num_layers


def record(into: dict[str, Tensor], name: str) -> Any:
    def hook(_module: nn.Module, _inputs: object, output: Tensor) -> None:
        into[name] = output

    return hook


def test_positions_match_the_golden_vectors(golden: Any) -> None:
    vectors, denoiser = golden.vectors("positional"), golden.model.denoiser
    stage = denoiser.root_model
    assert torch.equal(stage.positions(vectors["in.signed_index"]), vectors["const.motion_position_rows"])
    assert torch.equal(stage.embed_timestep.rows(vectors["in.timesteps"]), vectors["const.time_rows"])
    with torch.no_grad():
        for name, model in (("root", denoiser.root_model), ("body", denoiser.body_model)):
            vectors.check(f"out.time_embedding_{name}", model.embed_timestep(vectors["in.timesteps"])[:, 0])


def make_denoiser(layout: Representation, **changes: Any) -> Any:
    torch.manual_seed(0)
    transformer = TransformerConfig(width=16, feed_forward=24, num_layers=2, num_heads=2)
    config = DenoiserConfig(transformer=transformer, latent_dim=6, text_tokens=1, text_dim=5)
    return build_denoiser(replace(config, **changes), layout).eval()


def make_window(layout: Representation, rows: list[tuple[int, int, int]], num_tokens: int, seed: int = 0) -> Window:
    """Rows of (history, horizon, future) in tokens; every row has goals in its horizon and its last future token."""
    generator = torch.Generator().manual_seed(seed)
    mask = torch.zeros(len(rows), 4 * num_tokens, layout.feature_dim)
    for row, (history, horizon, future) in enumerate(rows):
        mask[row, 4 * history, 3:50] = 1
        if future:
            mask[row, 4 * (history + horizon + future) - 2, :3] = 1
    return Window(
        history_len=torch.tensor([4 * row[0] for row in rows]),
        generation_len=torch.tensor([4 * row[1] for row in rows]),
        num_frames=4 * num_tokens,
        text=torch.randn(len(rows), 1, 5, generator=generator),
        heading=torch.randn(len(rows), generator=generator),
        observed=torch.randn(mask.shape, generator=generator) * mask,
        mask=mask,
        text_mask=torch.ones(len(rows), 1, dtype=torch.bool),
    )


def make_tokens(window: Window, width: int) -> Tensor:
    tokens = torch.randn(len(window.heading), window.num_tokens, width, generator=torch.Generator().manual_seed(9))
    return tokens * (window.history_tokens | window.generation_tokens)[..., None]


ROWS = [(0, 3, 2), (2, 3, 0), (4, 2, 3)]


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_row_does_not_depend_on_the_batch(golden: Any, variant: str) -> None:
    """Rows of different lengths, padded to one size, give what each gives alone at its own size."""
    layout = golden.model.representation
    denoiser = make_denoiser(layout, **VARIANTS[variant])
    together = make_window(layout, ROWS, 9)
    tokens, step = make_tokens(together, ROOT_NUMBERS + 6), torch.tensor([9, 0, 4])
    with torch.no_grad():
        batch = denoiser(tokens, step, together)
        for row, lengths in enumerate(ROWS):
            size, one = sum(lengths), slice(row, row + 1)
            alone = replace(
                together,
                history_len=together.history_len[one],
                generation_len=together.generation_len[one],
                num_frames=4 * size,
                text=together.text[one],
                heading=together.heading[one],
                observed=together.observed[one, : 4 * size],
                mask=together.mask[one, : 4 * size],
                text_mask=together.text_mask[one],
            )
            result = denoiser(tokens[one, :size], step[one], alone)
            torch.testing.assert_close(batch[one, :size], result, atol=2e-5, rtol=0)
            assert not batch[row, size:].any(), "padding comes out as zero"


@pytest.mark.parametrize("variant", VARIANTS)
def test_history_passes_unchanged_and_every_weight_has_a_gradient(golden: Any, variant: str) -> None:
    layout = golden.model.representation
    denoiser = make_denoiser(layout, **VARIANTS[variant]).train()
    window = make_window(layout, ROWS, 9)
    tokens = make_tokens(window, ROOT_NUMBERS + 6)
    predicted = denoiser(tokens, torch.tensor([1, 2, 3]), window)
    assert torch.equal(predicted[window.history_tokens], tokens[window.history_tokens])
    predicted[window.generation_tokens].square().sum().backward()
    idle = [name for name, weight in denoiser.named_parameters() if weight.grad is None or not weight.grad.any()]
    assert idle == []


def test_the_body_stage_does_not_train_the_root_stage(golden: Any) -> None:
    layout = golden.model.representation
    denoiser = make_denoiser(layout).train()
    window = make_window(layout, ROWS, 9)
    predicted = denoiser(make_tokens(window, ROOT_NUMBERS + 6), torch.tensor([1, 2, 3]), window)
    predicted[..., ROOT_NUMBERS:].square().sum().backward()
    assert not any(weight.grad.any() for weight in denoiser.root_model.parameters())
    assert all(weight.grad.any() for weight in denoiser.body_model.output_linear.parameters())


def test_every_weight_has_a_gradient_in_a_batch_without_future(golden: Any) -> None:
    """Distributed training waits for the gradient of every weight."""
    layout = golden.model.representation
    denoiser = make_denoiser(layout).train()
    window = make_window(layout, [(1, 3, 0)], 4)
    denoiser(make_tokens(window, ROOT_NUMBERS + 6), torch.tensor([1]), window).sum().backward()
    assert [name for name, weight in denoiser.named_parameters() if weight.grad is None] == []


def test_goals_with_an_empty_mask_have_no_effect(golden: Any) -> None:
    layout = golden.model.representation
    denoiser = make_denoiser(layout)
    window = make_window(layout, ROWS, 9)
    tokens, step = make_tokens(window, ROOT_NUMBERS + 6), torch.tensor([1, 2, 3])
    empty = replace(window, observed=torch.zeros_like(window.mask), mask=torch.zeros_like(window.mask))
    with torch.no_grad():
        free = denoiser(tokens, step, window.without_constraints())
        torch.testing.assert_close(denoiser(tokens, step, empty), free, atol=1e-5, rtol=0)
        assert (denoiser(tokens, step, window) - free).abs().max() > 1e-3, "goals matter"


def test_masked_text_has_no_effect(golden: Any) -> None:
    layout = golden.model.representation
    denoiser = make_denoiser(layout, use_text_mask=True, text_tokens=3)
    window = make_window(layout, [(1, 2, 0)], 3)
    tokens, step = make_tokens(window, ROOT_NUMBERS + 6), torch.tensor([4])
    long_text = torch.randn(1, 5, 5, generator=torch.Generator().manual_seed(1))
    only_first = torch.tensor([[True, False, False, False, False]])
    with torch.no_grad():
        masked = denoiser(tokens, step, replace(window, text=long_text, text_mask=only_first))
        short = denoiser(tokens, step, replace(window, text=long_text[:, :1], text_mask=only_first[:, :1]))
        shown = denoiser(tokens, step, replace(window, text=long_text, text_mask=~only_first))
    torch.testing.assert_close(masked, short, atol=1e-5, rtol=0)
    assert (masked - shown).abs().max() > 1e-4


def test_mixed_precision_is_close_to_full_precision(golden: Any) -> None:
    vectors, denoiser = golden.vectors("denoiser_stages"), golden.model.denoiser
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        hybrid = denoiser(vectors["in.x"], vectors["in.timesteps"], vectors.window())
    assert hybrid.dtype == torch.float32
    assert (hybrid - vectors["out.hybrid"]).abs().max() < 0.1


def test_parameter_names_are_those_of_released_files(golden: Any) -> None:
    denoiser = golden.model.denoiser
    assert isinstance(denoiser, TwoStageDenoiser)
    names = {name.split(".")[0] for name in denoiser.state_dict()}
    assert names == {
        "global_root_hybrid_proj",
        "global_root_hybrid_constraints_proj",
        "local_root_hybrid_proj",
        "local_root_hybrid_constraints_proj",
        "future_constraints_proj",
        "root_model",
        "body_model",
    }


def test_a_position_outside_the_table_is_refused(golden: Any) -> None:
    stage = golden.model.denoiser.root_model
    with pytest.raises(IndexError):
        stage.positions(torch.tensor([-100_000]))
    with pytest.raises(IndexError):
        stage.positions(torch.tensor([100_000]))
