"""The useful FLOPs of a window, by formula: what any correct implementation has to compute, and nothing else.

Each vector that attention can see counts once: no padding, no hidden tokens, no guidance passes that are not needed,
and of the last layer only what is read. Not counted are values that stay the same over a window's steps (text, heading
and history vectors, the contribution of constraints) and the encoding of a history whose tokens could have been kept. A
multiply-add is two FLOPs; norms, softmax and activations do not count, as is usual.
"""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.model.config import ModelConfig, TransformerConfig


@dataclass(frozen=True)
class Pass:
    """One evaluation of the denoiser for one row: its visible tokens before and after the horizon."""

    history_tokens: int
    future_tokens: int = 0


def linear_flops(vectors: int, inputs: int, outputs: int) -> int:
    return 2 * vectors * inputs * outputs


def stack_flops(config: TransformerConfig, sequence: int, read: int | None = None) -> int:
    """All layers for one sequence of so many vectors, each of which attends to all.

    read: how many are read after the last layer (default: all); for the others, that layer needs only keys and values.
    """
    whole = _layer_flops(config, sequence, sequence)
    last = whole if read is None else _layer_flops(config, sequence, read)
    return (config.num_layers - 1) * whole + last


def _layer_flops(config: TransformerConfig, sequence: int, asking: int) -> int:
    """One layer for some vectors of a sequence, which attend to all of it."""
    width = config.width
    keys_and_values = linear_flops(sequence, width, 2 * width)
    queries_and_out = linear_flops(asking, width, 2 * width)
    scores_and_mixing = 2 * linear_flops(asking, width, sequence)
    return keys_and_values + queries_and_out + scores_and_mixing + 2 * linear_flops(asking, width, config.feed_forward)


def step_flops(config: ModelConfig, one: Pass) -> int:
    """One denoising step of one pass: the transformers of all stages, and the horizon's projections in and out."""
    denoiser = config.denoiser
    width, latent, root = denoiser.transformer.width, denoiser.latent_dim, denoiser.root_token_width
    horizon = config.horizon_tokens
    prefix = denoiser.text_tokens + 1 + int(denoiser.heading_token)
    stack = stack_flops(denoiser.transformer, prefix + one.history_tokens + horizon + one.future_tokens, horizon)
    if denoiser.num_stages == 1:
        hybrid = root + latent
        return stack + linear_flops(horizon, hybrid, width) + linear_flops(horizon, width, hybrid)
    first = linear_flops(horizon, root + latent, width) + linear_flops(horizon, width, root)
    # The last history token's local root contains a velocity into the prediction, so it changes with each step.
    changing = horizon + int(one.history_tokens > 0)
    local = config.patch * LOCAL_ROOT_WIDTH + latent
    second = linear_flops(changing, local, width) + linear_flops(horizon, width, latent)
    return 2 * stack + first + second


def decode_flops(config: ModelConfig, body_dim: int, history_tokens: int) -> int:
    """The decoder for the horizon alone, which attends to the history, whose keys are kept."""
    tokenizer = config.tokenizer
    if tokenizer is None:
        return 0
    transformer = tokenizer.transformer
    width, horizon = transformer.width, config.horizon_tokens
    condition = config.patch * LOCAL_ROOT_WIDTH
    linear = linear_flops(horizon, width, 4 * width) + 2 * linear_flops(horizon, width, transformer.feed_forward)
    # Token i of the horizon sees the history, those before it and itself.
    seen = horizon * history_tokens + horizon * (horizon + 1) // 2
    attention = 2 * linear_flops(1, width, seen)
    ends = (
        linear_flops(horizon, tokenizer.latent_dim, width)
        + linear_flops(horizon, width + condition, width)
        + linear_flops(horizon, width, config.patch * (body_dim + LOCAL_ROOT_WIDTH))
    )
    return transformer.num_layers * (linear + attention) + ends
