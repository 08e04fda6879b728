"""The tokenizer and its quantiser against the golden vectors."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from motiongen_ardy.model.tokenizer import Tokenizer
from motiongen_ardy.model.tokenizer.model import valid_tokens
from motiongen_ardy.model.tokenizer.quantizer import Quantizer
from tests.ardy.conftest import GoldenModel, Vectors


def tokenizer_of(golden: GoldenModel) -> Tokenizer:
    assert golden.model.tokenizer is not None
    return golden.model.tokenizer


@torch.no_grad()
def test_encoding_matches_the_golden_vectors(golden: GoldenModel) -> None:
    tokenizer, vectors = tokenizer_of(golden), golden.vectors("tokenizer")
    features, valid = vectors["in.motion_normalized"], vectors["in.pad_mask"]
    kept = vectors["out.token_mask"]
    vectors.check_equal("out.token_mask", valid_tokens(valid, 4))
    vectors.check("out.tokens", tokenizer.encode(features, valid), where=kept)
    vectors.check("out.hybrid", tokenizer.to_hybrid(features, valid))


@torch.no_grad()
def test_encoder_stages_match_the_golden_vectors(golden: GoldenModel) -> None:
    tokenizer, vectors = tokenizer_of(golden), golden.vectors("tokenizer")
    stages: dict[str, torch.Tensor] = {}
    encoder = tokenizer.encoder
    encoder.input_proj.register_forward_hook(lambda _m, _i, out: stages.update(patches=out))
    encoder.seqTransEncoder.register_forward_hook(lambda _m, _i, out: stages.update(transformer=out))
    encoder.output_proj.register_forward_hook(lambda _m, _i, out: stages.update(output=out))
    tokenizer.encode(vectors["in.motion_normalized"], vectors["in.pad_mask"])
    kept = vectors["out.token_mask"]
    vectors.check("mid.encoder_patches", stages["patches"], where=kept)
    vectors.check("mid.encoder_transformer", stages["transformer"], where=kept)
    vectors.check("mid.encoder_output", stages["output"], where=kept)
    vectors.check("mid.codes", tokenizer.quantizer.quantize(stages["output"]), where=kept)


@torch.no_grad()
def test_requantising_and_decoding_match_the_golden_vectors(golden: GoldenModel) -> None:
    tokenizer, vectors = tokenizer_of(golden), golden.vectors("tokenizer")
    vectors.check("requantize.out.latent", tokenizer.requantize(vectors["requantize.in.latent"]))
    valid = vectors["in.pad_mask"]
    codes = tokenizer.codes(vectors["decode.in.latent"])
    body, root = tokenizer.decoder(codes, vectors["decode.in.external_cond"], valid_tokens(valid, 4))
    name = "decode.out.body" if "decode.out.body" in vectors else "decode.out.explicit"
    vectors.check(name, body, where=valid)
    vectors.check("decode.out.root", root, where=valid)


@pytest.mark.parametrize("levels", [5, 8, 16, 33, 64])
def test_quantised_codes_match_the_golden_vectors(levels: int, common_vectors: Callable[[str], Vectors]) -> None:
    vectors = common_vectors("fsq")
    codes = Quantizer((levels,)).quantize(vectors["in.z"][:, None])[:, 0]
    away_from_ties = vectors[f"out.tie_margin_{levels}"] > 1e-3
    assert away_from_ties.float().mean() > 0.9
    expected = vectors[f"out.codes_{levels}"]
    torch.testing.assert_close(codes[away_from_ties], expected[away_from_ties], atol=1e-6, rtol=0)


def test_rounding_is_idempotent_and_admits_one_more_value_than_quantising() -> None:
    quantizer = Quantizer((64,))
    values = torch.linspace(-1.5, 1.5, 4001)[:, None]
    rounded = quantizer.round(values)
    assert torch.equal(quantizer.round(rounded), rounded)
    assert len(rounded.unique()) == 65
    assert len(quantizer.quantize(torch.linspace(-9, 9, 4001)[:, None]).unique()) == 64


def test_the_quantiser_passes_gradients_through() -> None:
    values = torch.zeros(3, 1, requires_grad=True)
    Quantizer((64,)).quantize(values).sum().backward()
    assert values.grad is not None
    assert bool((values.grad > 0.5).all())


@torch.no_grad()
def test_encoding_is_causal(golden: GoldenModel) -> None:
    tokenizer, vectors = tokenizer_of(golden), golden.vectors("tokenizer")
    features = vectors["in.motion_normalized"]
    changed = features.clone()
    changed[:, 12:] += 1
    torch.testing.assert_close(tokenizer.encode(changed)[:, :3], tokenizer.encode(features)[:, :3], atol=1e-5, rtol=0)
    assert not torch.equal(tokenizer.encode(changed)[:, 3:], tokenizer.encode(features)[:, 3:])
