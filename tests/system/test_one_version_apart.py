"""Clients and servers of the last release of the protos, taken from git, with those of today."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.server_process import ready

pytestmark = pytest.mark.system

PARTS = ("proto/python", "ardy", "server", "client/python", "client/tools", "compliance")
PLAYED = """
import asyncio, sys
from motiongen_client import MotionClient

async def play(address):
    async with MotionClient(address) as client:
        session = await client.open("a person walks forward")
        edit = session.set_prompt("a person runs forward")
        waypoint = session.add_waypoint(0.0, 3.0, frame=session.frame_in(3.0))
        frames = [frame.index async for frame in session.frames(2.0, realtime=False)]
        assert frames == list(range(len(frames))) and frames, frames
        assert (await edit).effective_frame is not None
        await waypoint
        end = await session.close()
        print(end.reason, len(frames))

asyncio.run(play(sys.argv[1]))
"""


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tree at the last release of the protos, without weights."""
    last = ["git", "log", "-1", "--format=%H", "--", "proto/released.binpb"]
    commit = subprocess.run(last, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
    assert commit, "git has no history here: clone it whole"
    folder = tmp_path_factory.mktemp("before")
    packed = ["git", "archive", commit, "proto/python", "server", "client/python", "tests", "ardy/motiongen_ardy"]
    archive = subprocess.run(packed, cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tree:
        tree.extractall(folder, filter="data")
    return folder


def environment(tree: Path) -> dict[str, str]:
    """An environment in which Python finds the parts of a tree before the installed ones."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(str(tree / part) for part in (*PARTS, "."))}


@contextmanager
def serving(tree: Path, state: Path) -> Iterator[str]:
    """A server of a tree, whose engines compute nothing. state: the folder for its state. Yields its address."""
    command = [sys.executable, "-m", "tests.bench.null_server", "--port", "0", "--ops-port", "0", "--devices", "cpu:1"]
    more = ["--profile-s", "0.2", "--log-level", "WARNING", "--admit-load", "100"]
    variables = {**environment(tree), "XDG_STATE_HOME": str(state)}
    process = subprocess.Popen([*command, *more], cwd=tree, env=variables, stdout=subprocess.PIPE, text=True)
    with ready(process) as told:
        yield f"127.0.0.1:{told['grpc_port']}"
    assert process.returncode == 0


def played(tree: Path, address: str) -> str:
    """The output of a client of a tree that opens a session, edits it, plays two seconds and closes it."""
    done = subprocess.run(
        [sys.executable, "-c", PLAYED, address], cwd=tree, env=environment(tree), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_client_of_the_last_release_plays_on_todays_server(before: Path, tmp_path: Path) -> None:
    with serving(ROOT, tmp_path) as address:
        assert played(before, address) == played(ROOT, address) == "client 40"


def test_todays_client_plays_on_a_server_of_the_last_release(before: Path, tmp_path: Path) -> None:
    with serving(before, tmp_path) as address:
        assert played(ROOT, address) == "client 40"
