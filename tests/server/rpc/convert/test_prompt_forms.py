"""The three forms of a prompt: text, the id of a preset, and its embedding."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Code, Guidance, Open, SessionKey, SetPrompts
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event, prompt_texts
from motiongen_server.rpc.limits import Limits
from motiongen_server.text.presets import Preset
from tests.server.engine.fakes import FACTS

WAVE = Preset("wave", "a person waves", np.array([3, 4], np.float32))


def catalog_of(*presets: Preset) -> Catalog:
    guidance = Guidance(1.5, 2.5)
    return Catalog(FACTS, Limits(), guidance, "CC0-1.0", text_encoder="hashed-2", history_frames=16, presets=presets)


CATALOG = catalog_of(WAVE)
KEY = SessionKey(3, 9)


def edit(**span: object) -> session_pb2.SessionEvent:
    spans = [motion_pb2.PromptSpan(prompt_id=1, **span)]  # type: ignore[arg-type]
    return session_pb2.SessionEvent(event_seq=2, edit_prompts=session_pb2.EditPrompts(upsert=spans))


def embedding(values: list[float], encoder: str = "hashed-2") -> motion_pb2.TextEmbedding:
    return motion_pb2.TextEmbedding(text_encoder=encoder, values=values)


def take(event: session_pb2.SessionEvent) -> object:
    assert prompt_texts(event, CATALOG) == ()  # nothing to encode
    return engine_event(event, KEY, 1.0, {}, CATALOG)


def converted(event: session_pb2.SessionEvent) -> SetPrompts:
    edited = take(event)
    assert isinstance(edited, SetPrompts)
    return edited


def test_preset_needs_no_encoder_and_provides_its_text() -> None:
    (prompt,) = converted(edit(preset_id="wave", end_frame=80)).upsert
    assert (prompt.text, prompt.end_frame) == ("a person waves", 80)
    np.testing.assert_array_equal(prompt.embedding, [3, 4])


def test_catalogue_lists_presets_text_encoder_and_width() -> None:
    (model,) = CATALOG.response("").models
    assert (model.text_encoder, model.text_width) == ("hashed-2", FACTS.embedding_dim)
    assert [(preset.preset_id, preset.text) for preset in model.presets] == [("wave", "a person waves")]


@pytest.mark.parametrize("label", ["", "a person limps"])
def test_embedding_arrives_unchanged_and_its_text_is_a_label(label: str) -> None:
    (prompt,) = converted(edit(embedding=embedding([-0.5, 2.25]), text=label)).upsert
    assert prompt.text == label
    assert prompt.embedding.dtype == np.float32
    np.testing.assert_array_equal(prompt.embedding, [-0.5, 2.25])


def test_a_session_opens_with_an_embedding() -> None:
    spans = [motion_pb2.PromptSpan(prompt_id=7, embedding=embedding([1, 2]))]
    event = session_pb2.SessionEvent(event_seq=1, open=session_pb2.OpenSession(prompts=spans))
    opened = engine_event(event, KEY, 1.0, {}, CATALOG)
    assert isinstance(opened, Open)
    np.testing.assert_array_equal(opened.spec.prompts[0].embedding, [1, 2])


@pytest.mark.parametrize(
    ("span", "code", "reason", "field", "allowed"),
    [
        ({"preset_id": "jump"}, Code.NOT_FOUND, "UNKNOWN_PRESET", "preset_id", "wave"),
        ({"preset_id": "wave", "text": "a person waves"}, None, "AMBIGUOUS_PROMPT", "preset_id", "text"),
        ({"preset_id": "wave", "embedding": embedding([1, 2])}, None, "AMBIGUOUS_PROMPT", "preset_id", "text"),
        (
            {"embedding": embedding([1, 2], "llm2vec-0123-bfloat16")},
            Code.FAILED_PRECONDITION,
            "WRONG_TEXT_ENCODER",
            "embedding.text_encoder",
            "hashed-2",
        ),
        ({"embedding": embedding([1, 2, 3])}, None, "WRONG_LENGTH", "embedding.values", "2 numbers"),
        ({"embedding": embedding([])}, None, "WRONG_LENGTH", "embedding.values", "2 numbers"),
        ({"embedding": embedding([1, math.nan])}, None, "NOT_FINITE", "embedding.values", "finite"),
        ({"embedding": embedding([1, 1e30])}, None, "VALUE_OUT_OF_RANGE", "embedding.values", "finite"),
        ({"embedding": embedding([1, 2]), "text": "x" * 1001}, None, "PROMPT_TOO_LONG", "text", "1000"),
        ({}, None, "EMPTY_PROMPT", "text", "1 to 1000"),
    ],
)
def test_invalid_prompt_is_refused_with_what_is_allowed(
    span: dict[str, object], code: Code | None, reason: str, field: str, allowed: str
) -> None:
    event = edit(**span)
    with pytest.raises(EventRefused) as caught:
        take(event)
    assert caught.value.code == (code or Code.INVALID_ARGUMENT)
    assert caught.value.reason == reason
    assert caught.value.field == f"edit_prompts.upsert[0].{field}"
    assert allowed in caught.value.allowed


@pytest.mark.parametrize(
    ("count", "allowed"),
    [
        (0, "an id of Model.presets: none, this model has no presets"),
        (2, "an id of Model.presets: p0, p1"),
        (18, "an id of Model.presets: " + ", ".join(f"p{number}" for number in range(16)) + ", and 2 more"),
    ],
)
def test_refusal_of_an_unknown_preset_lists_presets_and_counts_omitted_ones(count: int, allowed: str) -> None:
    catalog = catalog_of(*(replace(WAVE, preset_id=f"p{number}") for number in range(count)))
    with pytest.raises(EventRefused) as caught:
        engine_event(edit(preset_id="jump"), KEY, 1.0, {}, catalog)
    assert caught.value.allowed == allowed
