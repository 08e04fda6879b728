"""Creating the text encoder, the presets and the store from the settings at start-up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.text import HashedTextEncoder
from motiongen_ardy.text.prompt_file import encode_prompts, write_prompt_file
from motiongen_server.config import ServerConfig
from motiongen_server.models.loader import load_encoder, load_presets, open_store
from motiongen_server.settings import SettingError
from tests.server.engine.fakes import FACTS
from tests.server.text.encoder.encoder_process import EncoderProcess

WIDTH = FACTS.embedding_dim
PROMPTS = [("bow", "a person bows"), ("wave", "a person waves")]


def config(**settings: object) -> ServerConfig:
    return ServerConfig(**settings)  # type: ignore[arg-type]


def prompt_file(folder: Path, width: int = WIDTH) -> str:
    path = folder / f"prompts{width}.safetensors"
    write_prompt_file(path, encode_prompts(HashedTextEncoder(width), PROMPTS))
    return str(path)


def test_presets_of_the_servers_encoder_are_read(tmp_path: Path) -> None:
    settings = config(text_encoder="hashed", presets=prompt_file(tmp_path))
    presets = load_presets(settings, load_encoder(settings, FACTS).identity, FACTS)
    assert [(preset.preset_id, preset.text) for preset in presets] == PROMPTS
    np.testing.assert_array_equal(presets[1].embedding, HashedTextEncoder(WIDTH).encode(["a person waves"])[0])
    assert load_presets(config(), "any", FACTS) == ()


def test_presets_of_another_encoder_or_width_are_refused_with_both_names(tmp_path: Path) -> None:
    path = prompt_file(tmp_path)
    with pytest.raises(SettingError, match=rf"'hashed-{WIDTH}'.*'llm2vec-1-float32'"):
        load_presets(config(presets=path), "llm2vec-1-float32", FACTS)
    with pytest.raises(SettingError, match=rf"3 numbers each.*takes {WIDTH}"):
        load_presets(config(presets=prompt_file(tmp_path, 3)), "hashed-3", FACTS)
    with pytest.raises(SettingError, match=r"cannot use presets.*cannot be read"):
        load_presets(config(presets=str(tmp_path / "none")), "any", FACTS)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("static", f"takes {WIDTH}"),
        ("grpc:nowhere", "not the address"),
        ("gradio:nowhere", "no address"),
        ("prompts:nowhere", "cannot be read"),
        ("abacus", "static, hashed, llm2vec"),
        ("a" * 300, "File name too long"),
    ],
)
def test_unusable_encoder_setting_is_refused(name: str, said: str) -> None:
    with pytest.raises(SettingError, match=said) as refused:
        load_encoder(config(text_encoder=name), FACTS)
    assert repr(name) in str(refused.value)


def test_prompt_file_serves_as_the_encoder(tmp_path: Path) -> None:
    encoder = load_encoder(config(text_encoder=f"prompts:{prompt_file(tmp_path)}"), FACTS)
    assert encoder.identity == f"hashed-{WIDTH}"
    np.testing.assert_array_equal(encoder.encode(["a person bows"]), HashedTextEncoder(WIDTH).encode(["a person bows"]))


def test_server_started_without_its_encoder_has_the_stored_vectors(tmp_path: Path) -> None:
    log, store = tmp_path / "log.txt", str(tmp_path / "prompts.db")
    with EncoderProcess(log, "--text-encoder", "hashed", "--width", str(WIDTH)) as process:
        settings = config(text_encoder=f"grpc:{process.address}", prompt_store=store)
        encoder = load_encoder(settings, FACTS)
        first = open_store(settings, encoder.identity, FACTS)
        assert first is not None
        first.put("a person bows", encoder.encode(["a person bows"])[0])
        first.close()
        process.kill()
        impatient = config(text_encoder=settings.text_encoder, prompt_store=store, prompt_timeout_s=0.1)
        again = load_encoder(impatient, FACTS)
        kept = open_store(impatient, again.identity, FACTS)
        assert kept is not None
        np.testing.assert_array_equal(kept.get("a person bows"), HashedTextEncoder(WIDTH).encode(["a person bows"])[0])
        kept.close()
        with pytest.raises(ConnectionError):
            again.encode(["a person waves"])
        with pytest.raises(SettingError, match="does not answer"):
            load_encoder(config(text_encoder=settings.text_encoder, prompt_timeout_s=0.1), FACTS)


def test_without_a_file_there_is_no_store() -> None:
    assert open_store(config(), "any", FACTS) is None
