"""The packed denoiser gives the results of the plain one, for rows that share nothing but the model."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.config import TransformerConfig
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights, Pass, batch_passes, guided_prediction, needed_passes
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.packed import PackedDenoiser, RowConditions
from motiongen_ardy.model.packed.linear import PackedLinear, least_agreeing
from motiongen_ardy.model.packed.stack import Group, PackedStack
from motiongen_ardy.model.transformer import TransformerStack
from motiongen_ardy.model.window import Window
from tests.ardy.variants import VARIANTS, varied

GOLDEN = Path(__file__).parents[2] / "data" / "golden"
TOLERANCE = 5e-5


def rows_of(
    model: Model, packed: PackedDenoiser, shape: tuple[int, int, bool], weights: GuidanceWeights, seed: int
) -> tuple[list[RowConditions], Tensor, Tensor, Tensor]:
    """Two rows of one shape (history tokens, future tokens, constrained): conditions, noisy horizon, step, expected."""
    history, future, constrained = shape
    config, random = model.config, torch.Generator().manual_seed(seed)
    horizon = config.horizon // 4
    num_tokens, width = history + horizon + future, 20 + config.denoiser.latent_dim
    tokens = torch.randn(2, num_tokens, width, generator=random)
    tokens[:, history + horizon :] = 0
    text = torch.randn(2, config.denoiser.text_tokens, config.denoiser.text_dim, generator=random)
    text[0] = 0
    heading = torch.randn(2, generator=random)
    observed = mask = None
    if constrained:
        mask = torch.zeros(2, 4 * num_tokens, model.representation.feature_dim)
        for row in range(2):
            first, second = torch.randint(4 * history, 4 * num_tokens, (2,), generator=random).tolist()
            mask[row, first, :5] = 1
            mask[row, second, 5:20] = 1
        observed = torch.randn(mask.shape, generator=random) * mask
    passes = [needed_passes(config.guidance, weights, has_text, constrained) for has_text in (False, True)]
    step = torch.randint(0, config.num_base_steps, (2,), generator=random)
    history_len = torch.full((2,), 4 * history)
    window = Window(
        history_len, torch.full_like(history_len, config.horizon), 4 * num_tokens, text, heading, observed, mask
    )
    expected = guided_prediction(model.denoiser, tokens, step, window, batch_passes(passes))
    generated = slice(history, history + horizon)
    vectors = packed.vectors(tokens[:, :history], text, heading)
    goals = [None, None] if observed is None or mask is None else packed.goals(observed, mask, history)
    conditions = packed.conditions(vectors, passes, goals, [None, None])
    return conditions, tokens[:, generated], step, expected[:, generated]


SHAPES = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 6), st.booleans()), min_size=1, max_size=5)
WEIGHTS = st.sampled_from([GuidanceWeights(2, 2), GuidanceWeights(0, 1), GuidanceWeights(1, 0), GuidanceWeights(0, 0)])


@pytest.mark.parametrize("name", ["tiny-core27", "tiny-g134"])
def test_rows_of_any_shapes_in_one_batch_equal_the_plain_denoiser(name: str) -> None:
    model = load_checkpoint(GOLDEN / name / "checkpoint")
    packed = PackedDenoiser(model.denoiser, model.config.num_base_steps, model.config.horizon, torch.float32)

    @settings(max_examples=12, deadline=None)
    @given(SHAPES, WEIGHTS, st.integers(0, 1000))
    def check(shapes: list[tuple[int, int, bool]], weights: GuidanceWeights, seed: int) -> None:
        assert_equal(model, packed, shapes, weights, seed)

    check()


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_equals_the_plain_denoiser(name: str) -> None:
    base = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    torch.manual_seed(0)
    layout = base.representation
    model = build_model(varied(base.config, name, layout.body_dim), layout.stats).eval().requires_grad_(False)
    packed = PackedDenoiser(model.denoiser, model.config.num_base_steps, model.config.horizon, torch.float32)
    constrained = model.config.denoiser.constraints
    assert_equal(model, packed, [(3, 2, constrained), (0, 0, False), (1, 4, constrained)], GuidanceWeights(2, 1.5), 1)


def assert_equal(
    model: Model,
    packed: PackedDenoiser,
    shapes: list[tuple[int, int, bool]],
    weights: GuidanceWeights,
    seed: int,
) -> None:
    with torch.no_grad():
        parts = [rows_of(model, packed, shape, weights, seed + index) for index, shape in enumerate(shapes)]
        batch = packed.batch([conditions for rows, *_ in parts for conditions in rows])
        noisy, step, expected = (torch.cat([part[index] for part in parts]) for index in (1, 2, 3))
        for _ in range(2):  # the layout is written to in every step, and used again
            assert (packed.predict(batch, noisy, step) - expected).abs().max() < TOLERANCE


def test_bfloat16_is_close_to_float32() -> None:
    model = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    packed = PackedDenoiser(model.denoiser, model.config.num_base_steps, model.config.horizon, torch.bfloat16)
    with torch.no_grad():
        rows, noisy, step, expected = rows_of(model, packed, (4, 3, True), GuidanceWeights(2, 2), 5)
        difference = packed.predict(packed.batch(rows), noisy, step) - expected
    assert difference.dtype == torch.float32
    assert difference.square().mean().sqrt() < 0.05 * expected.square().mean().sqrt()


def test_original_weights_can_be_released_once_packed() -> None:
    model = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    packed = PackedDenoiser(model.denoiser, model.config.num_base_steps, model.config.horizon, torch.float32)
    with torch.no_grad():
        rows, noisy, step, expected = rows_of(model, packed, (4, 3, True), GuidanceWeights(2, 2), 5)
        layers = [
            layer for stage in (model.denoiser.root_model, model.denoiser.body_model) for layer in stage.modules()
        ]
        linear = [layer.weight for layer in layers if isinstance(layer, nn.Linear)]
        before = sum(weight.nbytes for weight in linear)
        packed.release_originals()
        assert (packed.predict(packed.batch(rows), noisy, step) - expected).abs().max() < TOLERANCE
    assert sum(weight.nbytes for weight in linear) < before / 2
    with pytest.raises(RuntimeError):
        rows_of(model, packed, (4, 3, True), GuidanceWeights(2, 2), 5)


def test_a_pass_that_guidance_does_not_need_is_not_computed() -> None:
    model = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    packed = PackedDenoiser(model.denoiser, model.config.num_base_steps, model.config.horizon, torch.float32)
    vectors = {}
    for name, passes in {
        "one": (Pass(False, False, 1.0),),
        "two": (Pass(False, False, -1.0), Pass(True, False, 2.0)),
    }.items():
        config = model.config.denoiser
        history = torch.zeros(1, 2, 20 + config.latent_dim)
        text = torch.zeros(1, config.text_tokens, config.text_dim)
        conditions = packed.conditions(packed.vectors(history, text, torch.zeros(1)), [passes], [None], [None])
        vectors[name] = packed.batch(conditions).num_vectors
    assert vectors["two"] == 2 * vectors["one"]


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("activation", [None, functional.gelu, functional.relu])
def test_a_packed_linear_layer_equals_the_plain_one(dtype: torch.dtype, activation: None) -> None:
    layer = nn.Linear(24, 40)
    packed = PackedLinear.of(layer, dtype, activation)
    values, addend = torch.randn(7, 24), torch.randn(7, 40)
    with torch.no_grad():
        plain = layer(values)
        expected = plain if activation is None else activation(plain)
        assert torch.allclose(packed(values.to(dtype)).float(), expected, atol=1e-5 if dtype == torch.float32 else 0.03)
        total = packed.plus(values.to(dtype), addend.to(dtype)).float()
        assert torch.allclose(total, plain + addend, atol=1e-5 if dtype == torch.float32 else 0.05)


def test_an_unknown_activation_is_refused() -> None:
    with pytest.raises(ValueError, match="gelu, relu or None"):
        PackedLinear.of(nn.Linear(2, 2), torch.float32, torch.tanh)


def test_least_agreeing_is_the_size_from_which_on_all_results_agree() -> None:
    values = torch.randn(64, 3)

    def product(count: int) -> Tensor:
        return values[:count] + 1e-4 * (count in (4, 16))

    assert least_agreeing(product, [1, 2, 4, 8, 16, 32, 64]) == 32
    assert least_agreeing(lambda count: values[:count], [1, 2, 4]) == 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize(("width", "outputs"), [(256, 768), (512, 256), (1024, 512), (2620, 256), (325, 32)])
def test_the_result_of_a_vector_does_not_depend_on_its_batch(width: int, outputs: int, dtype: torch.dtype) -> None:
    """With sums that cancel but for their rounding errors, so that another order of summation would show."""
    halves = torch.randn(600, width // 2)
    values = torch.cat([halves, -halves, torch.zeros(600, width % 2)], dim=1).to(dtype)
    layer = nn.Linear(width, outputs)
    with torch.inference_mode():
        layer.weight[:, width // 2 : 2 * (width // 2)] = layer.weight[:, : width // 2]
        packed = PackedLinear.of(layer, dtype)
        if not packed.onednn:
            pytest.skip(f"oneDNN multiplies no {dtype} on this processor")
        among_all = packed(values)
        for count in (1, 7, 20, 48, 130, 225, 300, 500):
            assert torch.equal(packed(values[:count]), among_all[:count]), count


@pytest.mark.parametrize("shape", [(3, 8), (2, 5, 8), (1, 0, 8)])
def test_a_layer_gives_the_same_results_when_its_batch_is_padded(shape: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    packed, values = PackedLinear.of(nn.Linear(8, 4), torch.float32), torch.randn(shape)
    plain, added = packed(values), packed.plus(values, torch.ones(*shape[:-1], 4))
    packed.least_vectors = 64
    assert packed(values).shape == plain.shape
    assert torch.allclose(packed(values), plain, atol=1e-6)
    assert torch.allclose(packed.plus(values, torch.ones(*shape[:-1], 4)), added, atol=1e-6)


@pytest.mark.parametrize("norm_first", [False, True])
def test_reading_part_of_the_last_layer_equals_computing_all_of_it(norm_first: bool) -> None:
    """Bit for bit: a vector that is not read affects those that are read by its key and value only."""
    torch.manual_seed(2)
    config = TransformerConfig(width=32, feed_forward=64, num_layers=2, num_heads=4, norm_first=norm_first)
    plain = TransformerStack(config).eval()
    groups = [Group(0, 3, 7, 2, 4), Group(21, 2, 5, 0, 4)]
    with torch.inference_mode():
        stack = PackedStack(plain, torch.float32)
        vectors = torch.randn(stack.filled(31), 32)
        whole = vectors
        for layer in stack.layers:
            whole = layer(whole, groups)
        expected = torch.cat([group.of(whole)[:, group.read].flatten(0, 1) for group in groups])
        assert torch.equal(stack(vectors, groups), expected)
