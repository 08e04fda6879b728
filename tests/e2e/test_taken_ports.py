"""Servers that tests restart at their earlier port retry once, since another process may hold it for a moment."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.scale.replicas import NULL_SERVER, Replica
from tests.server.text.encoder.encoder_process import EncoderProcess
from tests.waiting import until


def test_replica_is_started_again_if_its_port_is_taken(tmp_path: Path) -> None:
    replica = Replica("server", tmp_path, "none", program=NULL_SERVER)
    try:
        with socket.create_server(("127.0.0.1", replica.behind.port)):
            replica.begin()
            until(lambda: not replica.is_running)
        until(lambda: replica.is_ready)
    finally:
        replica.stop()


def test_replica_whose_port_stays_taken_raises_an_error(tmp_path: Path) -> None:
    replica = Replica("server", tmp_path, "none", program=NULL_SERVER)
    with socket.create_server(("127.0.0.1", replica.behind.port)):
        replica.begin()
        with pytest.raises(RuntimeError, match=f"server has ended: [^$]*{replica.behind.port}"):
            until(lambda: replica.is_ready)


def test_encoder_is_started_again_if_its_port_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with EncoderProcess(tmp_path / "log", "--text-encoder", "hashed", "--width", "32") as encoder:
        encoder.kill()
        taken = socket.create_server(("127.0.0.1", encoder.port))
        begun: Callable[..., str] = EncoderProcess._begun

        def freed_afterwards(*arguments: object) -> str:
            line = begun(*arguments)
            taken.close()
            return line

        monkeypatch.setattr(EncoderProcess, "_begun", freed_afterwards)
        encoder.start()
        assert "cannot listen on" in (tmp_path / "log").read_text(encoding="utf-8")
