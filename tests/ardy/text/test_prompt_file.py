"""Files of encoded prompts: round trip, use in place of an encoder, and files that are refused."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from motiongen_ardy.text import HashedTextEncoder, TextWidthMismatch, load_text_encoder
from motiongen_ardy.text.__main__ import main
from motiongen_ardy.text.encoder import PromptNotEncoded, Vectors
from motiongen_ardy.text.prompt_file import FORMAT, PromptFileError, encode_prompts, read_prompt_file, write_prompt_file
from tests.ardy.safetensors_bytes import safetensors_of

PROMPTS = [("wave", "a person waves"), ("walk", "a person walks, déjà vu")]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "prompts.safetensors"
    write_prompt_file(path, encode_prompts(HashedTextEncoder(6), PROMPTS))
    return path


def test_written_prompts_are_read_back(path: Path) -> None:
    prompts = read_prompt_file(path)
    assert list(zip(prompts.ids, prompts.texts, strict=True)) == PROMPTS
    assert prompts.text_encoder == "hashed-6"
    np.testing.assert_array_equal(prompts.vectors, HashedTextEncoder(6).encode([text for _, text in PROMPTS]))


def test_a_prompt_file_replaces_the_encoder_that_made_it(path: Path) -> None:
    encoder = load_text_encoder(f"prompts:{path}", 6)
    assert (encoder.identity, encoder.width) == ("hashed-6", 6)
    np.testing.assert_array_equal(
        encoder.encode(["a person waves", " "]), HashedTextEncoder(6).encode(["a person waves", " "])
    )
    with pytest.raises(PromptNotEncoded) as caught:
        encoder.encode(["a person sleeps"])
    assert caught.value.retry_after_s is None
    with pytest.raises(TextWidthMismatch, match="6 numbers, but the model takes 7"):
        load_text_encoder(f"prompts:{path}", 7)


def test_the_command_writes_a_prompt_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines, out = tmp_path / "prompts.txt", tmp_path / "out.safetensors"
    lines.write_text("wave\ta person waves\n\na person walks\n", encoding="utf-8")
    assert main([str(lines), str(out), "--encoder", "hashed", "--width", "5"]) == 0
    prompts = read_prompt_file(out)
    assert prompts.ids == ("wave", "a person walks")
    assert prompts.texts == ("a person waves", "a person walks")
    assert prompts.vectors.shape == (2, 5)
    assert "2 prompts, 5 numbers each, from hashed-5" in capsys.readouterr().out


def test_the_command_accepts_a_byte_order_mark_and_crlf(tmp_path: Path) -> None:
    """A byte order mark is no part of the first prompt, and nothing but line ends separates prompts."""
    lines, out = tmp_path / "prompts.txt", tmp_path / "out.safetensors"
    lines.write_bytes("\ufeffa person walks\r\nwave\ta person\u2028waves\r\n".encode())
    assert main([str(lines), str(out), "--encoder", "hashed", "--width", "5"]) == 0
    prompts = read_prompt_file(out)
    assert prompts.ids == ("a person walks", "wave")
    assert prompts.texts == ("a person walks", "a person\u2028waves")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "has no prompt; give one a line"),
        (b"\n \n", "has no prompt; give one a line"),
        (b"a person w\xe4lks\n", "is not UTF-8, from byte 10 on"),
        ("a person walks\n".encode("utf-16"), "is not UTF-8, from byte 0 on"),
    ],
)
def test_the_command_refuses_a_file_that_is_empty_or_not_utf8(
    content: bytes, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = tmp_path / "prompts.txt"
    lines.write_bytes(content)
    assert main([str(lines), str(tmp_path / "out"), "--encoder", "hashed", "--width", "5"]) == 2
    assert f"error: {lines} {said}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("lines", "options", "said"),
    [
        ("a person waves\na person waves\n", ["--encoder", "static"], "there twice"),
        ("wave\t \n", ["--encoder", "static"], "blank"),
        ("wave\n", ["--encoder", "hashed"], "any width"),
        ("wave\n", ["--encoder", "nothing"], "no text encoder 'nothing'"),
        ("x" * 65 + "\ta person waves\n", ["--encoder", "static"], "1 to 64 characters"),
    ],
)
def test_the_command_reports_errors(
    lines: str, options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "prompts.txt").write_text(lines)
    assert main([str(tmp_path / "prompts.txt"), str(tmp_path / "out"), *options]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


class NeverAsked(HashedTextEncoder):
    def encode(self, texts: Sequence[str]) -> Vectors:
        raise AssertionError(f"{len(texts)} prompts were encoded")


@pytest.mark.parametrize(
    ("lines", "out", "said"),
    [
        ("a person waves\na person waves\n", "out", "there twice"),
        ("wave\ta person waves\nwalk\ta person waves\n", "out", "the text 'a person waves' is there twice"),
        ("wave\t \n", "out", "blank"),
        ("x" * 65 + "\ta person waves\n", "out", "1 to 64 characters"),
        ("\ta person waves\n", "out", "1 to 64 characters"),
        ("wave\n", "none/out", "none is no folder"),
        ("wave\n", ".", "it is a folder"),
    ],
)
def test_nothing_is_encoded_if_the_file_could_not_be_written(
    lines: str, out: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("motiongen_ardy.text.__main__.load_text_encoder", lambda *_: NeverAsked(4))
    (tmp_path / "prompts.txt").write_text(lines)
    assert main([str(tmp_path / "prompts.txt"), str(tmp_path / out)]) == 2
    assert said in capsys.readouterr().err


def test_invalid_prompts_are_refused_before_they_are_encoded() -> None:
    with pytest.raises(PromptFileError, match="there twice"):
        encode_prompts(NeverAsked(4), [("wave", "a"), ("wave", "b")])


def test_long_prompts_without_ids_get_shortened_ids(tmp_path: Path) -> None:
    start = "a person walks forward, stops, looks around and then goes on " * 2
    (tmp_path / "prompts.txt").write_text(f"{start}slowly\n{start}fast\n{'x' * 64}\n")
    out = tmp_path / "out.safetensors"
    assert main([str(tmp_path / "prompts.txt"), str(out), "--encoder", "hashed", "--width", "5"]) == 0
    prompts = read_prompt_file(out)
    assert prompts.texts == (f"{start}slowly", f"{start}fast", "x" * 64)
    assert all(
        len(name) <= 64 and text.startswith(name[:50]) for name, text in zip(prompts.ids, prompts.texts, strict=True)
    )
    assert prompts.ids[2] == "x" * 64


def test_a_file_that_cannot_be_written_is_reported(path: Path, tmp_path: Path) -> None:
    with pytest.raises(PromptFileError, match="cannot be written"):
        write_prompt_file(tmp_path / "none" / "out", read_prompt_file(path))


GOOD = {"format": FORMAT, "text_encoder": "e", "ids": '["a", "b"]', "texts": '["A", "B"]'}


@pytest.mark.parametrize(
    ("changes", "vectors", "said"),
    [
        ({"format": "other"}, np.zeros((2, 3), np.float32), "no file of prompts"),
        ({"ids": '["a", "a"]'}, np.zeros((2, 3), np.float32), "there twice"),
        ({"ids": "[1, 2]"}, np.zeros((2, 3), np.float32), "no list of strings"),
        ({"ids": "["}, np.zeros((2, 3), np.float32), "no JSON"),
        ({"ids": "[" * 100_000}, np.zeros((2, 3), np.float32), "no JSON"),
        ({"ids": '["a", "\\ud800"]'}, np.zeros((2, 3), np.float32), "half of a surrogate pair"),
        ({"texts": '["A", "\\udfff"]'}, np.zeros((2, 3), np.float32), "half of a surrogate pair"),
        ({"texts": '["A"]'}, np.zeros((2, 3), np.float32), "do not fit"),
        ({}, np.zeros((3, 3), np.float32), "do not fit"),
        ({}, np.zeros(2, np.float32), "do not fit"),
        ({}, np.zeros((2, 3), np.float64), "float32"),
        ({}, np.full((2, 3), np.inf, np.float32), "finite"),
        ({}, np.full((2, 3), -1e30, np.float32), "at most 10,000"),
    ],
)
def test_an_inconsistent_file_is_refused(
    changes: dict[str, str], vectors: np.ndarray, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "prompts.safetensors"
    save_file({"vectors": vectors}, path, {**GOOD, **changes})
    with pytest.raises(PromptFileError, match=said):
        read_prompt_file(path)


@pytest.mark.parametrize("content", [b"", b"\x80\x04pickle", b"\xff" * 8 + b"{}", json.dumps(GOOD).encode()])
def test_a_file_that_is_not_safetensors_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "prompts.safetensors"
    path.write_bytes(content)
    with pytest.raises(PromptFileError, match="no safetensors file"):
        read_prompt_file(path)


@pytest.mark.parametrize(("kind", "size"), [("BF16", 2), ("F8_E4M3", 1), ("F64", 8)])
def test_vectors_of_another_type_are_refused_by_its_name(kind: str, size: int, tmp_path: Path) -> None:
    path = tmp_path / "prompts.safetensors"
    path.write_bytes(safetensors_of({"vectors": (kind, [2, 3], bytes(6 * size))}, GOOD))
    with pytest.raises(PromptFileError, match=f"are {kind}; they must be finite numbers in float32"):
        read_prompt_file(path)


def test_a_named_pipe_is_refused_without_blocking(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "prompts.safetensors")
    with pytest.raises(PromptFileError, match="no regular file"):
        read_prompt_file(tmp_path / "prompts.safetensors")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PromptFileError, match="cannot be read"):
        load_text_encoder(f"prompts:{tmp_path / 'none'}", 4)
