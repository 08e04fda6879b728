"""Prompts become texts of as many vectors as a model takes, and are brought to a device once."""

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
def test_fewer_vectors_are_filled_up_and_more_are_cut_off(count: int) -> None:
    embedding = np.arange(1, 4 * count + 1, dtype=np.float32).reshape(count, 4)
    prompt = Prompts(CONFIG).of(embedding)
    kept = min(count, 3)
    assert prompt.text.shape == (3, 4)
    assert np.array_equal(prompt.text[:kept].numpy(), embedding[:kept])
    assert not prompt.text[kept:].any()
    assert prompt.is_told


def test_one_vector_may_come_by_itself() -> None:
    assert Prompts(CONFIG).of(np.ones(4, np.float32)).text[0].tolist() == [1.0] * 4


def test_no_prompt_and_one_of_zeros_tell_nothing() -> None:
    held = Prompts(CONFIG)
    for nothing in (None, np.zeros(4, np.float32)):
        prompt = held.of(nothing)
        assert not prompt.is_told
        assert not prompt.text.any()


def test_an_embedding_is_made_a_text_once_and_never_taken_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prompts, "MOST_HELD", 8)
    held = Prompts(CONFIG)
    embedding = np.ones(4, np.float32)
    assert held.of(embedding).text is held.of(embedding).text
    for number in range(100):  # arrays that go, whose places in memory others take
        assert held.of(np.full(4, number, np.float32)).text[0, 0] == number


def test_texts_that_several_share_are_those_of_each_on_a_device() -> None:
    one, other = torch.ones(3, 4), torch.full((3, 4), 2.0)
    expected = [1.0, 2.0, 1.0, 1.0]
    with torch.inference_mode(), pretended():
        for texts in ([one, other, one, one], [one, other]):
            found = texts_on(AWAY, texts)
            assert found.device == AWAY
            assert found[:, 0, 0].tolist() == expected[: len(texts)]
