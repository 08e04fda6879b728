"""Text encoders: loaded by their names, what holds for every one, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file

from motiongen_ardy.text import (
    HashedTextEncoder,
    StaticTextEncoder,
    TextEncoder,
    TextEncoderChanged,
    TextWidthMismatch,
    UnknownTextEncoder,
    built_in_text_folder,
    load_text_encoder,
)
from motiongen_ardy.text.encoder import EachTextEncoder, Vectors
from tests.ardy.safetensors_bytes import safetensors_of

STATIC = StaticTextEncoder(built_in_text_folder())
ENCODERS: list[TextEncoder] = [HashedTextEncoder(7), STATIC]


@pytest.mark.parametrize("encoder", ENCODERS, ids=lambda encoder: encoder.identity)
@given(texts=st.lists(st.text(max_size=40), max_size=5))
def test_each_row_depends_on_its_text_alone_and_blank_texts_give_zeros(encoder: TextEncoder, texts: list[str]) -> None:
    vectors = encoder.encode(texts)
    assert vectors.shape == (len(texts), encoder.width)
    assert vectors.dtype == np.float32
    assert np.isfinite(vectors).all()
    for row, text in enumerate(texts):
        np.testing.assert_array_equal(vectors[row], encoder.encode([text])[0])
        if not text.strip():
            assert not vectors[row].any()


@pytest.mark.parametrize("encoder", ENCODERS, ids=lambda encoder: encoder.identity)
def test_a_single_text_in_place_of_a_list_is_refused(encoder: TextEncoder) -> None:
    """Otherwise each of its characters would be taken for a text."""
    with pytest.raises(ValueError, match="texts is one text, 'a person walks'; give a list of texts"):
        encoder.encode("a person walks")


@pytest.mark.parametrize("encoder", ENCODERS, ids=lambda encoder: encoder.identity)
def test_a_text_with_a_lone_surrogate_is_refused(encoder: TextEncoder) -> None:
    with pytest.raises(ValueError, match="half of a surrogate pair"):
        encoder.encode(["a person walks", "a person \ud83c"])


def test_a_static_vector_does_not_depend_on_other_texts_in_the_batch() -> None:
    texts = ["a person walks", " ", "x" * 300, "a person waves, then jumps and turns round", "12", "?!"]
    together = STATIC.encode(texts)
    for text, vector in zip(texts, together, strict=True):
        np.testing.assert_array_equal(STATIC.encode([text])[0], vector)
    assert not together[1].any()


def test_static_vectors_have_unit_scale_and_distinguish_prompts() -> None:
    walk, wave = STATIC.encode(["a person walks", "a person waves"])
    assert np.sqrt(np.square(walk).mean()) == pytest.approx(1, abs=1e-5)
    assert float(walk @ wave) / walk.size < 0.95


def test_a_model2vec_folder_is_loaded_by_its_path() -> None:
    assert load_text_encoder(str(built_in_text_folder()), STATIC.width).identity == STATIC.identity
    assert load_text_encoder("static").identity == STATIC.identity


def test_the_hashed_encoder_takes_any_width_and_requires_one() -> None:
    assert load_text_encoder("hashed", 4096).width == 4096
    with pytest.raises(UnknownTextEncoder, match="any width"):
        load_text_encoder("hashed")
    with pytest.raises(TextWidthMismatch, match="at least 1"):
        load_text_encoder("hashed", 0)


def test_an_encoder_of_another_width_than_the_model_is_refused() -> None:
    with pytest.raises(TextWidthMismatch, match=rf"'static' gives vectors of {STATIC.width} .* takes 4096"):
        load_text_encoder("static", 4096)


@pytest.mark.parametrize("name", ["none", "", "llm2vec2", "gradio", "prompts", "/etc"])
def test_an_unknown_name_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(UnknownTextEncoder, match="static, hashed, llm2vec, gradio:URL, prompts:FILE"):
        load_text_encoder(name, 8)


def test_a_folder_with_other_weights_is_refused(tmp_path: Path) -> None:
    (tmp_path / "model.safetensors").write_bytes(b"nothing")
    with pytest.raises(UnknownTextEncoder, match=r"no.* model2vec folder"):
        load_text_encoder(str(tmp_path), 8)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("tokenizer.json", b"nothing"),
        ("tokenizer.json", b"{}"),
        ("model.safetensors", b"nothing"),
        ("model.safetensors", safetensors_of({"other": ("F32", [1], bytes(4))}, {})),
        ("config.json", b"nothing"),
        ("config.json", b"[]"),
    ],
    ids=["no tokenizer", "an empty tokenizer", "no tensors", "other tensors", "no JSON", "another JSON"],
)
def test_a_folder_with_an_invalid_file_is_refused(tmp_path: Path, name: str, content: bytes) -> None:
    folder = shutil.copytree(built_in_text_folder(), tmp_path / "text")
    (folder / name).write_bytes(content)
    with pytest.raises(UnknownTextEncoder, match=f"{folder} is not a model2vec folder"):
        load_text_encoder(str(folder), STATIC.width)


def test_a_folder_with_vectors_that_are_not_finite_is_refused(tmp_path: Path) -> None:
    folder = shutil.copytree(built_in_text_folder(), tmp_path / "text")
    vectors = load_file(folder / "model.safetensors")["embeddings"].astype(np.float32)
    vectors[-1, 3] = np.nan
    save_file({"embeddings": vectors}, folder / "model.safetensors")
    with pytest.raises(UnknownTextEncoder, match="not finite"):
        load_text_encoder(str(folder), STATIC.width)


class Faulty(EachTextEncoder):
    """An encoder that makes invalid vectors of some texts."""

    def encode_one(self, text: str) -> Vectors:
        numbers = {"nothing": np.nan, "endless": -np.inf, "far": -1e30}
        return np.full(4, numbers[text], np.float32) if text in numbers else np.ones(len(text), np.float32)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nothing", "not finite"),
        ("endless", "not finite"),
        ("far", "beyond 10,000"),
        ("a", r"shape \(1,\); it must be \(4,\)"),
    ],
)
def test_vectors_of_an_encoder_in_this_process_are_checked_too(text: str, said: str) -> None:
    encoder = Faulty("lying", 4)
    np.testing.assert_array_equal(encoder.encode(["walk", " "]), [[1] * 4, [0] * 4])
    with pytest.raises(TextEncoderChanged, match=said):
        encoder.encode(["walk", text])
