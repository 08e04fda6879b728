"""LLM2Vec without its libraries: which tokens are averaged, how prompts are cut, which folders are used.

`python -m tests.bench.llm2vec` checks it with transformers and peft.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
import torch
from huggingface_hub import constants
from hypothesis import given
from hypothesis import strategies as st
from safetensors import SafetensorError

from motiongen_ardy.text import UnknownTextEncoder, llm2vec, load_text_encoder
from motiongen_ardy.text.llm2vec import (
    FIRST_ADAPTER,
    MAX_TEXT_TOKENS,
    SECOND_ADAPTER,
    Llm2VecFolders,
    both_ways,
    find_folders,
    fingerprint,
    mean_of_last,
    shortened,
)

LLAMA = "someone/Llama-8B"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders as they must lie below $TEXT_ENCODERS_DIR."""
    for name in (LLAMA, FIRST_ADAPTER, SECOND_ADAPTER):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "model.safetensors").write_bytes(name.encode() * 10)
    (tmp_path / FIRST_ADAPTER / "adapter_config.json").write_text(json.dumps({"base_model_name_or_path": LLAMA}))
    monkeypatch.setenv("TEXT_ENCODERS_DIR", str(tmp_path))
    return tmp_path


def test_only_the_tokens_of_the_prompt_are_averaged() -> None:
    hidden = torch.arange(10.0).reshape(5, 2)
    torch.testing.assert_close(mean_of_last(hidden, 2), hidden[3:].mean(0))
    torch.testing.assert_close(mean_of_last(hidden, 5), hidden.mean(0))


def test_the_attention_mask_hides_no_token() -> None:
    mask = both_ways(torch.zeros(1, 6, dtype=torch.int64), torch.bfloat16)
    assert (mask.shape, mask.dtype) == ((1, 1, 6, 6), torch.bfloat16)
    assert not mask.any()


@given(st.lists(st.text(alphabet="abc", min_size=1, max_size=30), min_size=1, max_size=200))
def test_a_text_that_is_too_long_is_cut_after_a_word(words: list[str]) -> None:
    text = " ".join(words)
    kept = shortened(text, len)
    assert kept.split() == words[: len(kept.split())]
    assert len(kept) <= MAX_TEXT_TOKENS
    assert (kept == text) == (len(text) <= MAX_TEXT_TOKENS)


@given(st.integers(1, 40), st.integers(1, 1000))
def test_of_words_that_are_equally_long_none_is_cut_that_had_room(length: int, count: int) -> None:
    text = " ".join(["a" * length] * count)
    with_room = (MAX_TEXT_TOKENS + 1) // (length + 1)  # the last one needs no space after it
    assert len(shortened(text, len).split()) == min(count, with_room)


def test_one_long_word_is_left_for_the_tokenizer_to_cut() -> None:
    assert shortened("あ" * 1000, len) == "あ" * 1000


def test_the_folders_are_found_below_text_encoders_dir(home: Path) -> None:
    folders = find_folders()
    assert folders == Llm2VecFolders(home / LLAMA, (home / FIRST_ADAPTER, home / SECOND_ADAPTER))


def test_unreachable_hub_is_answered_with_where_to_put_the_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TEXT_ENCODERS_DIR", str(tmp_path))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    with pytest.raises(UnknownTextEncoder) as failure:
        find_folders()
    assert f"put the files into $TEXT_ENCODERS_DIR/{FIRST_ADAPTER}" in str(failure.value)
    assert "CHECKPOINTS_DIR" not in str(failure.value)


def test_an_adapter_that_names_no_model_is_refused(home: Path) -> None:
    for content in ("{}", "[", '["a"]'):
        (home / FIRST_ADAPTER / "adapter_config.json").write_text(content)
        with pytest.raises(UnknownTextEncoder, match="no adapter"):
            find_folders()


@pytest.mark.parametrize("name", ["../../etc", "/etc"])
def test_an_adapter_cannot_name_a_folder_outside_text_encoders_dir(
    home: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    (home / FIRST_ADAPTER / "adapter_config.json").write_text(json.dumps({"base_model_name_or_path": name}))
    with pytest.raises(UnknownTextEncoder, match="lacks its model"):
        find_folders()


def test_the_fingerprint_depends_on_the_content_of_every_folder(home: Path) -> None:
    folders = find_folders()
    prints = {fingerprint(folders)}
    assert fingerprint(folders) in prints
    for name in (LLAMA, FIRST_ADAPTER, SECOND_ADAPTER):
        path = home / name / "model.safetensors"
        path.write_bytes(path.read_bytes() + b"1")
        prints.add(fingerprint(folders))
    (home / LLAMA / "tokenizer.json").write_text("{}")
    prints.add(fingerprint(folders))
    assert len(prints) == 5


def test_without_its_libraries_the_error_says_what_to_install(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "peft", None)
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(UnknownTextEncoder, match=r"pip install 'motiongen-ardy\[llm2vec\]'"):
        load_text_encoder("llm2vec", 4096)


def test_an_unsupported_precision_is_refused(home: Path) -> None:
    with pytest.raises(UnknownTextEncoder, match=r"'int8'.*float32 or bfloat16"):
        load_text_encoder("llm2vec", 4096, precision="int8")


@pytest.mark.parametrize("error", [SafetensorError("the header is too small"), Exception("expected value at line 1")])
def test_unreadable_files_are_reported_with_their_folder(
    home: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def load(folders: Llm2VecFolders, dtype: torch.dtype) -> None:
        raise error

    monkeypatch.setattr(llm2vec, "_load", load)
    with pytest.raises(UnknownTextEncoder, match=f"cannot load llm2vec from {home / LLAMA}: {error}"):
        load_text_encoder("llm2vec", 4096)
