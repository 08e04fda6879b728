"""The encoder service as a process, and its client, while the process is killed, paused and restarted."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from motiongen_ardy.text import HashedTextEncoder, TextEncoderChanged, TextEncoderUnavailable, UnknownTextEncoder
from motiongen_server.text.encoder.client import RemoteEncoder
from tests.server.text.encoder.encoder_process import ROOT, EncoderProcess
from tests.waiting import LIMIT_S, until

PROMPTS = ["a person walks", "", "a person waves"]


@pytest.fixture
def hashed(tmp_path: Path) -> Iterator[EncoderProcess]:
    with EncoderProcess(tmp_path / "log.txt", "--text-encoder", "hashed", "--width", "16") as process:
        yield process


def encode_when_back(encoder: RemoteEncoder, prompts: list[str]) -> np.ndarray:
    """The result of `encode`, retried while the encoder is unavailable, at most for the time of a test."""

    def attempt() -> list[np.ndarray]:
        try:
            return [encoder.encode(prompts)]
        except TextEncoderChanged:
            raise
        except TextEncoderUnavailable:
            return []

    return until(attempt)[0]


def test_vectors_equal_the_encoders_own_for_any_number_of_texts(hashed: EncoderProcess) -> None:
    encoder = RemoteEncoder(hashed.address, LIMIT_S)
    own = HashedTextEncoder(16)
    assert (encoder.identity, encoder.width) == (own.identity, 16)
    many = [*PROMPTS, *(f"{number} jumps" for number in range(130)), *PROMPTS]
    np.testing.assert_array_equal(encoder.encode(many), own.encode(many))
    encoder.close()


def test_killed_service_is_unavailable_and_found_again_once_restarted(hashed: EncoderProcess) -> None:
    encoder = RemoteEncoder(hashed.address, LIMIT_S)
    hashed.kill()
    with pytest.raises(TextEncoderUnavailable) as away:
        encoder.encode(PROMPTS)
    assert "127.0.0.1" not in str(away.value)
    hashed.start()
    np.testing.assert_array_equal(encode_when_back(encoder, PROMPTS), HashedTextEncoder(16).encode(PROMPTS))
    encoder.close()


def test_service_restarted_with_another_encoder_is_refused_with_both_names(hashed: EncoderProcess) -> None:
    encoder = RemoteEncoder(hashed.address, LIMIT_S)
    hashed.kill()
    hashed.start("--width", "17")
    with pytest.raises(TextEncoderChanged, match=r"'hashed-17', not 'hashed-16'.*restarted"):
        encode_when_back(encoder, PROMPTS)
    encoder.close()


def test_paused_service_takes_too_long(hashed: EncoderProcess) -> None:
    encoder = RemoteEncoder(hashed.address, LIMIT_S)
    impatient = RemoteEncoder(hashed.address, 0.2, ("hashed-16", 16))  # sends nothing yet: its identity is given
    hashed.halt()
    with pytest.raises(TextEncoderUnavailable, match="takes too long"):
        impatient.encode(PROMPTS)
    hashed.go_on()
    np.testing.assert_array_equal(encode_when_back(encoder, PROMPTS), HashedTextEncoder(16).encode(PROMPTS))
    encoder.close()
    impatient.close()


def test_restarted_service_reads_vectors_from_its_store(tmp_path: Path) -> None:
    prompts, store = ["a person walks"], str(tmp_path / "store.db")
    counted = 'motiongen_encoder_texts_total{source="store"} 1.0'
    with EncoderProcess(tmp_path / "log.txt", "--text-encoder", "hashed", "--width", "16", "--store", store) as process:
        for is_known in (False, True):
            encoder = RemoteEncoder(process.address, LIMIT_S)
            np.testing.assert_array_equal(encoder.encode(prompts), HashedTextEncoder(16).encode(prompts))
            metrics = httpx.get(f"http://127.0.0.1:{process.ops_port}/metrics").text
            assert (counted in metrics) == is_known
            assert httpx.get(f"http://127.0.0.1:{process.ops_port}/readyz").status_code == 200
            encoder.close()
            assert process.stop() == 0
            process.start()


def test_given_identity_is_not_requested_but_checked_with_the_first_answer(hashed: EncoderProcess) -> None:
    hashed.kill()
    encoder = RemoteEncoder(hashed.address, LIMIT_S, ("hashed-16", 16))
    other = RemoteEncoder(hashed.address, LIMIT_S, ("hashed-15", 15))
    with pytest.raises(TextEncoderUnavailable):
        encoder.encode(PROMPTS)
    hashed.start()
    np.testing.assert_array_equal(encode_when_back(encoder, PROMPTS), HashedTextEncoder(16).encode(PROMPTS))
    with pytest.raises(TextEncoderChanged, match="'hashed-16', not 'hashed-15'"):
        encode_when_back(other, PROMPTS)
    encoder.close()
    other.close()


def test_client_gives_up_when_no_service_answers(hashed: EncoderProcess) -> None:
    hashed.kill()
    with pytest.raises(TextEncoderUnavailable, match="does not answer"):
        RemoteEncoder(hashed.address, 0.2)


@pytest.mark.parametrize(
    "address",
    [
        "localhost",
        "localhost:",
        "localhost:http",
        "",
        ":50052",
        "localhost:0",
        "localhost:65536",
        "localhost:111111",
        "localhost:\u00b2",
    ],
)
def test_invalid_address_is_refused(address: str) -> None:
    with pytest.raises(UnknownTextEncoder, match="not the address"):
        RemoteEncoder(address)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--text-encoder", "hashed"], "any width"),
        (["--text-encoder", "static", "--width", "4096"], "takes 4096"),
        (["--text-encoder", "gradio:nowhere"], "no address"),
        (["--text-encoder", "a" * 300], "File name too long"),
        (["--precision", "int8"], "precision is 'int8'"),
        (["--colour", "red"], "python -m motiongen_server.text.encoder --help"),
    ],
)
def test_invalid_setting_ends_the_process_with_a_message(options: list[str], said: str) -> None:
    command = [sys.executable, "-m", "motiongen_server.text.encoder", "--port", "0", "--ops-port", "0", *options]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 2
    assert said in ended.stderr
    assert "Traceback" not in ended.stderr


ENDED_EARLY = """
import os, signal, sys

class Ends:
    @staticmethod
    def find_spec(name, *_):
        if name == "motiongen_server.text.encoder.app":
            os.kill(os.getpid(), int(sys.argv[1]))

sys.meta_path.insert(0, Ends)
from motiongen_server.text.encoder.__main__ import main
main()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signal_before_the_service_has_started_ends_it_with_code_0(number: signal.Signals) -> None:
    """In a container it is the first process, which signals without a handler do not end."""
    command = [sys.executable, "-c", ENDED_EARLY, str(int(number))]
    done = subprocess.run(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
