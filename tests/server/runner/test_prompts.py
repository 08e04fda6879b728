"""Prompts become texts of as many vectors as a model takes, and are moved to a device once."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from motiongen_ardy.model.config import DenoiserConfig, TransformerConfig
from motiongen_server.runner import prompts
from motiongen_server.runner.prompts import Prompts, texts_on
from tests.pretend_device import AWAY, pretended

CONFIG = DenoiserConfig(TransformerConfig(64, 128, 2, 4), latent_dim=16, text_tokens=3, text_dim=4)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_missing_vectors_are_zeros_and_surplus_ones_are_cut_off(count: int) -> None:
    embedding = np.arange(1, 4 * count + 1, dtype=np.float32).reshape(count, 4)
    prompt = Prompts(CONFIG).of(embedding)
    kept = min(count, 3)
    assert prompt.text.shape == (3, 4)
    assert np.array_equal(prompt.text[:kept].numpy(), embedding[:kept])
    assert not prompt.text[kept:].any()
    assert prompt.is_told


def test_single_vector_needs_no_second_dimension() -> None:
    assert Prompts(CONFIG).of(np.ones(4, np.float32)).text[0].tolist() == [1.0] * 4


def test_absent_prompt_and_zeros_count_as_no_prompt() -> None:
    held = Prompts(CONFIG)
    for nothing in (None, np.zeros(4, np.float32)):
        prompt = held.of(nothing)
        assert not prompt.is_told
        assert not prompt.text.any()


def test_text_of_an_embedding_is_made_once_and_never_taken_for_another_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prompts, "MOST_HELD", 8)
    held = Prompts(CONFIG)
    embedding = np.ones(4, np.float32)
    assert held.of(embedding).text is held.of(embedding).text
    for number in range(100):  # arrays that are freed, whose memory others reuse
        assert held.of(np.full(4, number, np.float32)).text[0, 0] == number


def test_texts_on_a_device_are_right_for_rows_that_share_them() -> None:
    one, other = torch.ones(3, 4), torch.full((3, 4), 2.0)
    expected = [1.0, 2.0, 1.0, 1.0]
    with torch.inference_mode(), pretended():
        for texts in ([one, other, one, one], [one, other]):
            found = texts_on(AWAY, texts)
            assert found.device == AWAY
            assert found[:, 0, 0].tolist() == expected[: len(texts)]
