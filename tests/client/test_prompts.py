"""The forms of a prompt, as they are sent."""

from __future__ import annotations

import math

import numpy as np
import pytest

from motiongen_client import InvalidInput, Preset, TextEmbedding
from motiongen_client.convert import prompt_span
from motiongen_client.prompts import prompt_name


def test_text_prompt_is_sent_as_text() -> None:
    span = prompt_span(3, "a person walks", 40)
    assert (span.prompt_id, span.text, span.start_frame) == (3, "a person walks", 40)
    assert not span.preset_id
    assert not span.HasField("embedding")


def test_preset_is_sent_by_its_id_alone() -> None:
    span = prompt_span(1, Preset("bow"), None)
    assert (span.preset_id, span.text, span.start_frame) == ("bow", "", 0)


@pytest.mark.parametrize("values", [[1.5, -2.0], np.array([1.5, -2.0], np.float64), (1.5, -2)])
def test_embedding_is_sent_by_value_with_the_name_of_its_encoder(values: object) -> None:
    span = prompt_span(1, TextEmbedding(values, "static-1", "a person bows"), None)  # type: ignore[arg-type]
    assert list(span.embedding.values) == [1.5, -2.0]
    assert (span.embedding.text_encoder, span.text) == ("static-1", "a person bows")


@pytest.mark.parametrize("values", [[math.nan], [[1.0, 2.0]], "text", 3.0])
def test_embedding_that_is_not_a_finite_vector_is_refused(values: object) -> None:
    with pytest.raises(InvalidInput):
        TextEmbedding(values, "static-1")  # type: ignore[arg-type]


def test_preset_without_an_id_is_refused() -> None:
    with pytest.raises(InvalidInput):
        Preset("")


def test_prompt_name_describes_each_form_of_prompt() -> None:
    names = [
        prompt_name(each) for each in ("hop", Preset("bow"), TextEmbedding([1], "e", "bows"), TextEmbedding([1], "e"))
    ]
    assert names == ["the prompt 'hop'", "the preset 'bow'", "the embedding of 'bows'", "an embedding"]


def test_text_that_utf_8_cannot_encode_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"prompt: .* allowed is a text that UTF-8 can write, a Preset or a Text"):
        prompt_span(1, "walk\udcff", None)
    with pytest.raises(InvalidInput, match=r"text: .* allowed is a text that UTF-8 can write"):
        TextEmbedding([1.0], "static-1", "\ud800")
