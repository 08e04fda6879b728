"""The arrows of ARCHITECTURE.md: which room may import what, read from the source of every file."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

STANDARD = frozenset(sys.stdlib_module_names)


@dataclass(frozen=True)
class Room:
    """Files below any of `paths` may import the standard library less `never`, and modules at or below any of `may`."""

    paths: tuple[str, ...]
    may: frozenset[str]
    never: frozenset[str] = frozenset()


def room(paths: str, may: str, never: str = "") -> Room:
    return Room(tuple(paths.split()), frozenset(may.split()), frozenset(never.split()))


NUMBERS = "numpy torch"
FILES = "huggingface_hub safetensors yaml"
TEXT = "model2vec tokenizers"
PICTURES = "matplotlib"
GRPC = "grpc grpc_health grpc_reflection"

# The first room that holds a file decides.
ROOMS = (
    room("proto/generate.py", "google grpc_tools"),
    room("proto/python", "google grpc motiongen"),
    room(
        "ardy/data ardy/train ardy/evaluate", f"ardy {NUMBERS} {FILES} {TEXT} {PICTURES} rich tensorboard transformers"
    ),
    room("ardy/text", f"ardy {NUMBERS} {FILES} {TEXT} peft transformers"),
    room("ardy/formats", f"ardy {NUMBERS} pygltflib"),
    room("ardy", f"ardy {NUMBERS} {FILES} {TEXT}"),
    room("server/engine", "numpy server.engine", never="asyncio"),
    room("server/runner", f"{NUMBERS} ardy server.runner server.engine.types server.engine.ports", never="asyncio"),
    room(
        "server/convert server/convert.py",
        "numpy motiongen server.abilities server.catalog server.convert server.engine.types server.errors "
        "server.limits",
    ),
    room("server/catalog.py", "motiongen server.abilities server.engine.types server.limits server.presets"),
    room("server/abilities.py", "numpy server.engine.types"),
    room("server/presets.py", "server.engine.types"),
    room("server/outbox.py server/rate.py server/limits.py", "server.engine.types"),
    room("server/ops.py", "starlette uvicorn prometheus_client"),
    room("server/metrics.py server/model_metrics.py", "prometheus_client server.engine server.model_metrics"),
    room("server/config.py server/settings.py", "_typeshed server.errors server.settings"),
    room("server/errors.py", "grpc grpc_status google server.engine.types"),
    room("server/prompts.py", "numpy server.engine.types server.errors"),
    room("server/app.py server/__main__.py", f"{GRPC} google motiongen server"),
    room("server/loading.py server/repertoire.py", f"{NUMBERS} ardy server"),
    room("server/encoder", f"{GRPC} ardy.text google motiongen numpy prometheus_client server torch"),
    room("server/split", "msgpack numpy zmq server", never="asyncio"),
    room("server", "grpc google motiongen numpy server"),
    room(
        "client/python/motiongen_client/bench",
        "google grpc motiongen numpy motiongen_client hdrh matplotlib psutil rich yaml",
    ),
    room("client/python/motiongen_client", "google grpc motiongen numpy motiongen_client matplotlib rich"),
    room("client/python/examples examples", "numpy matplotlib motiongen_client"),
)


def imported_modules(source: str, package: str) -> Iterator[tuple[int, str]]:
    """Line and full dotted name of each import, also those inside functions. package: dotted, for relative imports."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def breaches(source: str, path: str, rule: Room) -> list[str]:
    package = ".".join(Path(path).parent.parts)
    found = []
    for line, module in imported_modules(source, package):
        root = module.partition(".")[0]
        allowed = is_below(module, rule.may) or (root in STANDARD and not is_below(module, rule.never))
        if not allowed:
            found.append(f"{path}:{line} imports {module}; its room may import {sorted(rule.may)}")
    return found


def is_below(module: str, names: frozenset[str]) -> bool:
    return any(module == name or module.startswith(name + ".") for name in names)


def room_of(path: Path) -> Room | None:
    for candidate in ROOMS:
        if any(path == Path(place) or Path(place) in path.parents for place in candidate.paths):
            return candidate
    return None


def test_every_import_follows_an_arrow(repository: Any) -> None:
    found = []
    for path in repository.files:
        rule = room_of(path) if path.suffix == ".py" else None
        if rule is not None:
            found += breaches((repository.root / path).read_text(encoding="utf-8"), path.as_posix(), rule)
    assert found == []


def test_every_source_file_is_in_a_room(repository: Any) -> None:
    tops = {"proto", "ardy", "server", "client", "examples"}
    homeless = [str(p) for p in repository.files if p.suffix == ".py" and p.parts[0] in tops and room_of(p) is None]
    assert homeless == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("ardy/text/gradio.py", "import grpc"),
        ("ardy/text/gradio.py", "from server.engine import types"),
        ("server/engine/session.py", "import torch"),
        ("server/engine/session.py", "import asyncio"),
        ("server/engine/session.py", "from server import runner"),
        ("server/engine/session.py", "from .. import convert"),
        ("server/engine/session.py", "def late():\n    from motiongen.v1 import session_pb2"),
        ("server/service.py", "import ardy.rollout"),
        ("server/service.py", "import zmq"),
        ("server/split/messages.py", "import grpc"),
        ("server/convert.py", "import grpc"),
        ("server/runner/row.py", "from motiongen.v1 import motion_pb2"),
        ("client/python/motiongen_client/session.py", "import torch"),
        ("client/python/motiongen_client/session.py", "import server.config"),
        ("proto/python/motiongen/__init__.py", "import ardy"),
    ],
)
def test_a_breach_is_seen(path: str, source: str) -> None:
    rule = room_of(Path(path))
    assert rule is not None
    assert breaches(source, path, rule)


def test_importing_the_client_brings_no_torch(repository: Any) -> None:
    code = "import sys, motiongen_client, motiongen_client.blocking; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=repository.root
    )
    roots = {name.partition(".")[0] for name in loaded.stdout.split()}
    assert "grpc" in roots
    assert not roots & {"torch", "ardy", "server", "hdrh", "matplotlib", "psutil", "rich", "yaml"}
