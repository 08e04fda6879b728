"""A real server process with two models: sessions on both, one unloaded, loaded and reloaded while the other plays."""

from __future__ import annotations

import asyncio
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from motiongen_ardy.checkpoint.model_card import BUILT_IN_MODEL
from motiongen_client import EventRefused, MotionClient, Session, SessionEnded, SessionOptions
from motiongen_client.admin import AdminClient
from motiongen_tools.cli import run
from tests.conftest import ROOT
from tests.waiting import LIMIT_S

TINY = ROOT / "tests" / "data" / "golden" / "tiny-g134" / "checkpoint"


@dataclass(frozen=True)
class TwoModels:
    """Addresses of a server that was started with the built-in model and a tiny one, and the tiny one's name."""

    address: str
    admin: str
    tiny: str


@pytest.fixture(scope="module")
def two_models(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoModels]:
    log = tmp_path_factory.mktemp("two_models") / "stderr.txt"
    settings = ["--port", "0", "--ops-port", "0", "--print-ports", "--devices", "cpu:2", "--drain-wait-s", "0"]
    settings += ["--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false", "--text-encoder", "hashed"]
    settings += ["--model", BUILT_IN_MODEL, "--model", str(TINY), "--admin-listen", "127.0.0.1:0"]
    with log.open("w", encoding="utf-8") as errors:
        command = [sys.executable, "-m", "motiongen_server", *settings]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True)
        assert process.stdout is not None
        with process.stdout:
            line = process.stdout.readline()  # ends when the server is ready, or with the process
            assert line, log.read_text()
            ports = json.loads(line)
            admin = f"127.0.0.1:{ports['admin_port']}"
            yield TwoModels(f"127.0.0.1:{ports['grpc_port']}", admin, TINY.name)
            process.send_signal(signal.SIGTERM)
            exit_code = process.wait(timeout=LIMIT_S)
    assert exit_code == 0, log.read_text()


async def played(session: Session, seconds: float = 1.0) -> list[int]:
    return [frame.index async for frame in session.frames(seconds, realtime=False)]


async def test_client_plays_sessions_of_both_models(two_models: TwoModels) -> None:
    async with asyncio.timeout(LIMIT_S), MotionClient(two_models.address) as client:
        names = [model.model_id for model in client.catalog.models]
        assert names == [BUILT_IN_MODEL, two_models.tiny]
        first = await client.open("a person walks")
        second = await client.open("a person walks", options=SessionOptions(model_id=two_models.tiny))
        assert first.rig.rig_id == client.catalog.models[0].rig_id != second.rig.rig_id
        for session in (first, second):
            assert await played(session) == list(range(session.rig.frame_rate_hz))
        with pytest.raises(EventRefused, match="UNKNOWN_MODEL"):
            await client.open("a person walks", options=SessionOptions(model_id="nobody"))


async def test_model_is_unloaded_loaded_and_reloaded_while_the_other_plays(two_models: TwoModels) -> None:
    tiny = SessionOptions(model_id=two_models.tiny)
    async with (
        asyncio.timeout(LIMIT_S),
        MotionClient(two_models.address) as client,
        AdminClient(two_models.admin) as admin,
    ):
        stays = await client.open("a person walks")
        goes = await client.open("a person walks", options=tiny)
        await played(goes)
        with pytest.raises(EventRefused, match="SESSIONS_OPEN"):
            await admin.unload_model(two_models.tiny)
        assert await admin.unload_model(two_models.tiny, grace_s=0) == 1
        with pytest.raises(SessionEnded, match="model_unloaded"):
            await played(goes, 60)
        assert await played(stays) == list(range(20))
        with pytest.raises(EventRefused, match="UNKNOWN_MODEL"):
            await client.open("a person walks", options=tiny)

        loading = asyncio.create_task(admin.load_model(str(TINY)))
        assert await played(stays) == list(range(20, 40))
        assert (await loading).state == "serving"
        again = await client.open("a person walks", options=tiny)
        await played(again)
        status, closed = await admin.reload_model(two_models.tiny, grace_s=0)
        assert (status.model_id, closed) == (two_models.tiny, 1)
        await played(await client.open("a person walks", options=tiny))
        assert await played(stays) == list(range(40, 60))


async def test_folders_without_a_model_are_refused_without_side_effects(two_models: TwoModels, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text("model: [", encoding="utf-8")
    async with asyncio.timeout(LIMIT_S), AdminClient(two_models.admin) as admin:
        before = [status.model_id for status in await admin.list_models()]
        for source in (tmp_path, tmp_path / "nowhere"):
            with pytest.raises(EventRefused, match="CANNOT_LOAD") as refused:
                await admin.load_model(str(source))
            assert str(source) in str(refused.value)
        with pytest.raises(EventRefused, match="MODEL_LOADED"):
            await admin.load_model(str(TINY))
        assert [status.model_id for status in await admin.list_models()] == before


def test_command_line_manages_models(two_models: TwoModels, capsys: pytest.CaptureFixture[str]) -> None:
    server = ["admin", "--server", two_models.admin]
    assert run([*server, "list"]) == 0
    assert "serving" in capsys.readouterr().out
    assert run([*server, "reload", two_models.tiny, "--grace", "0"]) == 0
    assert f"{two_models.tiny} is reloaded; 0 sessions were closed." in capsys.readouterr().out
    assert run([*server, "unload", two_models.tiny]) == 0
    assert run([*server, "unload", BUILT_IN_MODEL]) == 1
    assert "LAST_MODEL" in capsys.readouterr().err
    assert run([*server, "load", str(TINY)]) == 0
    assert f"{two_models.tiny} is served now." in capsys.readouterr().out


async def test_connected_client_follows_changes_of_models(two_models: TwoModels) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        MotionClient(two_models.address) as client,
        AdminClient(two_models.admin) as admin,
    ):
        default = client.catalog.models[0]
        await admin.unload_model(BUILT_IN_MODEL)
        (clip,) = await client.generate_clip(
            "a person walks", num_frames=8
        )  # the default model that the client knows is gone
        session = await client.open("a person walks")
        assert clip.model_id == session.opened.model_id == client.catalog.models[0].model_id == two_models.tiny
        assert clip.motion.rig.rig_id == session.rig.rig_id != default.rig_id
        await played(session)
        await admin.load_model(BUILT_IN_MODEL)
        own = SessionOptions(model_id=BUILT_IN_MODEL)
        (clip,) = await client.generate_clip("a person walks", num_frames=8, options=own)
        session = await client.open("a person walks", options=own)
        assert clip.motion.rig.rig_id == session.rig.rig_id == default.rig_id
        await played(session)


async def test_opening_a_session_updates_the_clients_catalogue(two_models: TwoModels) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        MotionClient(two_models.address) as client,
        AdminClient(two_models.admin) as admin,
    ):
        default = client.catalog.models[0]
        await admin.unload_model(default.model_id)
        session = await client.open("a person walks")  # the default model that the client knows is gone
        assert session.opened.model_id == client.catalog.models[0].model_id != default.model_id
        await played(session)
        await admin.load_model(BUILT_IN_MODEL if default.model_id == BUILT_IN_MODEL else str(TINY))
        await played(await client.open("a person walks", options=SessionOptions(model_id=default.model_id)))
        assert default.model_id in [model.model_id for model in client.catalog.models]
