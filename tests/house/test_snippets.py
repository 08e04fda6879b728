"""Every Python snippet of a page runs against a real server, given the names that it assumes."""

from __future__ import annotations

import ast
import asyncio
import inspect
import json
import re
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc
import numpy as np
import pytest

from motiongen_client import MotionClient
from motiongen_server.identity.tls import ServerTls, TlsFiles
from tests.conftest import ROOT, LiveServer
from tests.contract.local import LocalServer
from tests.e2e.lost_line import FACTS_AS_SERVED
from tests.server.identity.files import AUTHORITY, TenantsFile, copy_pair
from tests.waiting import LIMIT_S

BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SKELETON: dict[str, Any] = {
    "names": ["pelvis", "chest", "skull"],
    "parents": [-1, 0, 1],
    "offsets_cm": [[0.0, 110.0, 0.0], [0.0, 45.0, 0.0], [0.0, 20.0, 3.0]],
    "rest_quat_wxyz": [[1.0, 0.0, 0.0, 0.0]] * 3,
}
JOINT_MAP = {
    "metres_per_unit": 0.01,
    "joints": {
        ours: {"from": theirs, "axes": ["left", "up", "forward"]}
        for ours, theirs in {"Hips": "pelvis", "Spine3": "chest", "Head": "skull"}.items()
    },
    "root": {"from": ["pelvis"], "to": ["Hips"], "scale": 1.0, "ground": {"source_height": 0.0, "height": 0.0}},
}
TRUSTED = Path(AUTHORITY).read_bytes()

Names = dict[str, Any]
CLIENT, SECURITY = "client/python/README.md", "docs/security.md"
MADE: dict[str, list[Callable[[Names], bool]]] = {
    CLIENT: [
        lambda names: len(names["printed"]) == 80,  # 4 s at 20 frames a second
        lambda names: (names["root_cm"].shape, names["bones_xyzw"].shape) == ((3,), (27, 4)),
        lambda names: len(names["shown"]) == 40 and len(names["clip_on_ground"]) == len(names["clip"].motion),
        lambda names: names["poses"].joint_rotation_quat_wxyz.shape[1:] == (3, 4),
        lambda names: names["command"].shape == (36,),
    ],
    SECURITY: [lambda names: names["walker"].opened.model_id == FACTS_AS_SERVED.model_id],
}
"""A check of the result of each snippet of a page, in order."""


def snippets(page: str) -> list[str]:
    return BLOCK.findall((ROOT / page).read_text(encoding="utf-8"))


@pytest.fixture
def in_a_folder_with_a_joint_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hero.json").write_text(json.dumps(JOINT_MAP), encoding="utf-8")


@pytest.fixture
async def names(live_server: LiveServer, in_a_folder_with_a_joint_map: None) -> AsyncIterator[Names]:
    """The names that snippets assume: a session that has played, a clip, a terrain, a skeleton of the user's."""
    printed: list[object] = []
    shown: list[object] = []
    async with MotionClient(live_server.address) as client:
        walker = await client.open("a person walks forward")
        frames = [frame async for frame in walker.frames(seconds=1, realtime=False)]
        (clip,) = await client.generate_clip("a person walks forward", num_frames=40)
        yield {
            "MotionClient": MotionClient,
            "address": live_server.address,
            "print": lambda *said: printed.append(said),
            "printed": printed,
            "walker": walker,
            "frame": frames[-1],
            "clip": clip,
            "terrain": SimpleNamespace(height=lambda x, z: 0.1 * np.asarray(z)),
            "show": shown.append,
            "shown": shown,
            "motion_of_new_frames": walker.motion(),
            "before": None,
            "now_s": 0.0,
            **SKELETON,
        }


@pytest.fixture
async def secure(tmp_path: Path) -> AsyncIterator[Names]:
    """The names for a snippet that connects to a server with TLS and tokens."""
    tenants = TenantsFile(tmp_path)
    token = tenants.one()
    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path)))
    async with LocalServer(facts=FACTS_AS_SERVED, callers=tenants.callers(), tls=tls) as server:
        yield {
            "MotionClient": MotionClient,
            "grpc": grpc,
            "address": server.address,
            "authority": TRUSTED,
            "present_token": lambda: token,
        }


async def run(page: str, number: int, names: Names) -> None:
    text = re.sub(r'"(localhost|motion\.example):50051"', "address", snippets(page)[number])
    code = compile(text, f"{page}, snippet {number}", "exec", flags=ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    made = eval(code, names)
    if inspect.isawaitable(made):
        async with asyncio.timeout(LIMIT_S):
            await made
    assert MADE[page][number](names)


@pytest.mark.parametrize("number", range(len(MADE[CLIENT])))
async def test_client_snippet_runs(number: int, names: Names) -> None:
    await run(CLIENT, number, names)


async def test_security_snippet_runs(secure: Names) -> None:
    await run(SECURITY, 0, secure)


def test_every_snippet_is_run(repository: Any) -> None:
    """Except the README's example, which test_examples.py runs."""
    pages = [path.as_posix() for path in repository.files if path.suffix == ".md" and path != Path("README.md")]
    assert {page: len(found) for page in pages if (found := snippets(page))} == {
        page: len(made) for page, made in MADE.items()
    }
