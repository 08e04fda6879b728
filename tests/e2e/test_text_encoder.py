"""A server whose text encoder is a separate process, which is killed, paused, and replaced by another encoder.

Characters keep moving throughout; known prompts take effect, and others are refused in time.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.text import HashedTextEncoder
from motiongen_ardy.text.prompt_file import encode_prompts, write_prompt_file
from motiongen_client import EventRefused, MotionClient, Preset, Session, TextEmbedding
from tests.conftest import ROOT, TINY_MODEL
from tests.server.text.encoder.encoder_process import EncoderProcess
from tests.server_process import ready
from tests.waiting import LIMIT_S, try_again

WIDTH = 32
SETTINGS = (
    "--port",
    "0",
    "--ops-port",
    "0",
    "--print-ports",
    "--devices",
    "cpu:1",
    "--drain-wait-s",
    "0",
    "--profile-s",
    "0.3",
    "--admit-load",  # however busy the machine
    "1000",
    "--degrade",
    "false",
    "--prompt-timeout-s",  # longer than any test here waits for the encoder
    str(2 * LIMIT_S),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("text_encoder")


@pytest.fixture(scope="module")
def shared(folder: Path) -> Iterator[EncoderProcess]:
    with EncoderProcess(folder / "encoder.txt", "--text-encoder", "hashed", "--width", str(WIDTH)) as process:
        yield process


@pytest.fixture
def encoder(shared: EncoderProcess) -> Iterator[EncoderProcess]:
    """The encoder that the server uses; it is restarted after each test."""
    yield shared
    shared.kill()
    shared.start()


@pytest.fixture(scope="module")
def address(shared: EncoderProcess, folder: Path) -> Iterator[str]:
    """A server that uses the encoder, with one preset and a prompt store."""
    presets = folder / "presets.safetensors"
    write_prompt_file(presets, encode_prompts(HashedTextEncoder(WIDTH), [("bow", "a person bows")]))
    text = ["--text-encoder", f"grpc:{shared.address}", "--presets", str(presets)]
    store = ["--prompt-store", str(folder / "prompts.db")]
    command = [sys.executable, "-m", "motiongen_server", *SETTINGS, "--model", str(TINY_MODEL), *text, *store]
    log = folder / "server.txt"
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True)
    with ready(process, log) as told:
        yield f"localhost:{told['grpc_port']}"
    assert process.returncode == 0, log.read_text()
    assert "Traceback" not in log.read_text()


async def move(session: Session, num_frames: int) -> None:
    """Play so many more frames."""
    async for _ in session.frames(seconds=num_frames / session.rig.frame_rate_hz, realtime=False):
        pass


async def opened(client: MotionClient, prompt: str) -> Session:
    """A session; retried while the server's encoder is unavailable."""
    while True:
        try:
            return await client.open(prompt)
        except EventRefused as refused:
            if refused.code != "UNAVAILABLE":
                raise
            await try_again()


async def answered_when_back(session: Session, text: str) -> None:
    """Give the prompt again until it is accepted."""
    while True:
        try:
            await session.set_prompt(text)
        except EventRefused as refused:
            if refused.code != "UNAVAILABLE":
                raise
            await try_again()
        else:
            return


async def test_with_a_killed_encoder_known_prompts_work_and_others_are_refused(
    encoder: EncoderProcess, address: str
) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(address) as client:
        session = await opened(client, "a person walks")
        await answered_when_back(session, "a person waves")
        encoder.kill()
        with pytest.raises(EventRefused) as refused:
            await session.set_prompt("a person yawns")
        assert (refused.value.code, refused.value.reason) == ("UNAVAILABLE", "TEXT_ENCODER_UNAVAILABLE")
        assert refused.value.retry_after_s
        await session.set_prompt("a person walks")  # known: from memory
        await session.set_prompt("a person bows")  # a preset, by its text
        await session.set_prompt(Preset("bow"))
        embedding = TextEmbedding(HashedTextEncoder(WIDTH).encode(["a person yawns"])[0], f"hashed-{WIDTH}")
        await session.set_prompt(embedding)
        other = await client.open(Preset("bow"))
        await move(other, 40)
        with pytest.raises(EventRefused) as unopened:
            await client.open("a person sneezes")
        assert unopened.value.reason == "TEXT_ENCODER_UNAVAILABLE"
        encoder.start()
        await answered_when_back(session, "a person yawns")
        await move(session, 40)


async def test_paused_encoder_delays_no_frames(encoder: EncoderProcess, address: str) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(address) as client:
        asker, other = await opened(client, "a person walks"), await opened(client, "a person waves")
        encoder.halt()
        edit = asker.set_prompt("a person shrugs")
        await other.set_prompt("a person walks")
        await asyncio.gather(move(asker, 60), move(other, 60))
        encoder.go_on()
        try:
            assert (await edit).effective_frame is not None
        except EventRefused as refused:  # on a busy machine the encoder may have counted as unavailable
            if refused.reason != "TEXT_ENCODER_UNAVAILABLE":
                raise
            await answered_when_back(asker, "a person shrugs")


async def test_vectors_of_a_replaced_encoder_are_refused(encoder: EncoderProcess, address: str) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(address) as client:
        session = await opened(client, "a person walks")
        encoder.kill()
        encoder.start("--width", str(WIDTH + 1))
        message = ""
        while f"hashed-{WIDTH + 1}" not in message:
            with pytest.raises(EventRefused) as refused:
                await session.set_prompt("a person coughs")
            message = str(refused.value)
        assert f"hashed-{WIDTH}'" in message
        await session.set_prompt("a person walks")


async def test_embeddings_of_another_encoder_or_width_are_refused(address: str) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(address) as client:
        (model,) = client.catalog.models
        assert (model.text_encoder, model.text_width) == (f"hashed-{WIDTH}", WIDTH)
        assert model.presets == {"bow": "a person bows"}
        session = await client.open()
        for embedding, reason in (
            (TextEmbedding(np.ones(WIDTH), "llm2vec-0-bfloat16"), "WRONG_TEXT_ENCODER"),
            (TextEmbedding(np.ones(WIDTH - 1), model.text_encoder), "WRONG_LENGTH"),
        ):
            with pytest.raises(EventRefused) as refused:
                await session.set_prompt(embedding)
            assert refused.value.reason == reason
