"""A client's prompt spans, given as text, preset id or embedding -> the engine's prompts."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Code, Float32Array, Prompt
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.checks import (
    check_count,
    check_finite,
    frame_number,
    identifier_of,
    number_array,
    refuse,
)

Embeddings = Mapping[str, Float32Array]


class _Unencoded(Mapping[str, Float32Array]):
    """Maps every text to an empty embedding: enough to check everything else in an event."""

    _nothing = np.zeros(0, np.float32)

    def __getitem__(self, text: str) -> Float32Array:
        return self._nothing

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


MOST_PRESETS_NAMED = 16
"""Most presets that a refusal names; `Model.presets` of the catalogue has all."""
UNENCODED: Embeddings = _Unencoded()
"""For events that are checked before their prompts are encoded."""
MAX_ABSOLUTE_VALUE = 1e4
"""Of a number in an embedding; encoders stay below a hundred, and far larger numbers overflow in bfloat16 products."""


def prompt_texts(event: session_pb2.SessionEvent, catalog: Catalog) -> tuple[str, ...]:
    """The texts that must be encoded before `engine_event` can be called.

    This is the only check of prompts' texts, made once, before any is encoded. Raises EventRefused for a bad one.
    """
    name = event.WhichOneof("event")
    if name == "open":
        spans, field = event.open.prompts, "open.prompts"
    elif name == "edit_prompts":
        spans, field = event.edit_prompts.upsert, "edit_prompts.upsert"
    else:
        return ()
    # A message has room for a thousand times as many prompts as a session.
    check_count(spans, catalog.limits.max_prompts, "TOO_MANY_PROMPTS", field)
    texts = (_text_to_encode(span, f"{field}[{index}]", catalog) for index, span in enumerate(spans))
    return tuple(text for text in texts if text is not None)


def _text_to_encode(span: motion_pb2.PromptSpan, field: str, catalog: Catalog) -> str | None:
    """The text; None for a span that has its embedding, or names a preset."""
    most = catalog.limits.max_prompt_characters
    if len(span.text) > most:
        given = f"the prompt has {len(span.text)} characters"
        raise refuse("PROMPT_TOO_LONG", f"{field}.text", given, f"1 to {most} characters")
    if span.HasField("embedding"):
        if span.preset_id:
            allowed = "text, preset_id or embedding; an embedding may have a text too, for people to read"
            raise refuse("AMBIGUOUS_PROMPT", f"{field}.preset_id", "the prompt has an embedding too", allowed)
        return None
    if span.preset_id:
        if span.text:
            allowed = "text, preset_id or embedding"
            raise refuse("AMBIGUOUS_PROMPT", f"{field}.preset_id", "the prompt has a text too", allowed)
        return None
    if not span.text.strip():
        allowed = f"1 to {most} characters, not all blank; remove the span for no prompt"
        raise refuse("EMPTY_PROMPT", f"{field}.text", "the prompt is blank", allowed)
    return span.text


def prompts_of(
    spans: Sequence[motion_pb2.PromptSpan], field: str, embeddings: Embeddings, catalog: Catalog
) -> tuple[Prompt, ...]:
    """The engine's prompts for spans that `prompt_texts` has accepted. embeddings: one for each text it returned.

    Raises EventRefused.
    """
    prompts = []
    for index, span in enumerate(spans):
        where = f"{field}[{index}]"
        text, embedding = _meaning(span, where, embeddings, catalog)
        start, end = (
            frame_number(span.start_frame, f"{where}.start_frame"),
            frame_number(span.end_frame, f"{where}.end_frame"),
        )
        if end and end <= start:
            raise refuse(
                "EMPTY_SPAN", f"{where}.end_frame", f"the span ends at {end}", f"above {start}, or 0 for open-ended"
            )
        identifier = identifier_of(span.prompt_id, f"{where}.prompt_id")
        prompts.append(Prompt(identifier, start or None, end or None, text, embedding))
    return tuple(prompts)


def with_embeddings(prompts: Sequence[Prompt], embeddings: Embeddings) -> tuple[Prompt, ...]:
    """Fill in the embeddings of prompts that `prompts_of` made with `UNENCODED`."""
    return tuple(each if each.embedding.size else replace(each, embedding=embeddings[each.text]) for each in prompts)


def _meaning(
    span: motion_pb2.PromptSpan, field: str, embeddings: Embeddings, catalog: Catalog
) -> tuple[str, Float32Array]:
    if span.HasField("embedding"):
        return span.text, _vector(span.embedding, f"{field}.embedding", catalog)
    if span.preset_id:
        preset = catalog.presets.get(span.preset_id)
        if preset is None:
            given, allowed = f"no preset {span.preset_id[:80]!r}", f"an id of Model.presets: {_named(catalog.presets)}"
            raise refuse("UNKNOWN_PRESET", f"{field}.preset_id", given, allowed, Code.NOT_FOUND)
        return preset.text, preset.embedding
    return span.text, embeddings[span.text]


def _named(presets: Collection[str]) -> str:
    names = list(presets)[:MOST_PRESETS_NAMED]
    if not names:
        return "none, this model has no presets"
    rest = len(presets) - len(names)
    return ", ".join(names) + (f", and {rest} more" if rest else "")


def _vector(embedding: motion_pb2.TextEmbedding, field: str, catalog: Catalog) -> Float32Array:
    if embedding.text_encoder != catalog.text_encoder:
        given = f"the embedding is from the text encoder {embedding.text_encoder[:80]!r}"
        allowed = f"{catalog.text_encoder}, as Model.text_encoder says"
        raise refuse("WRONG_TEXT_ENCODER", f"{field}.text_encoder", given, allowed, Code.FAILED_PRECONDITION)
    width = catalog.facts.embedding_dim
    values = number_array(embedding.values, width, f"{field}.values", f"{width} numbers, as Model.text_width says")
    allowed = f"finite numbers within +-{MAX_ABSOLUTE_VALUE:g}"
    check_finite(values, f"{field}.values", allowed)
    largest = float(np.abs(values).max(initial=0))
    if largest > MAX_ABSOLUTE_VALUE:
        raise refuse("VALUE_OUT_OF_RANGE", f"{field}.values", f"a number is as large as {largest:g}", allowed)
    return values
