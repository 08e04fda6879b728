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
        "ardy/motiongen_ardy/data ardy/motiongen_ardy/train ardy/motiongen_ardy/evaluate",
        f"ardy {NUMBERS} {FILES} {TEXT} {PICTURES} rich tensorboard transformers",
    ),
    room("ardy/motiongen_ardy/text", f"ardy {NUMBERS} {FILES} {TEXT} peft transformers"),
    room("ardy/motiongen_ardy/formats", f"ardy {NUMBERS} pygltflib"),
    room("ardy", f"ardy {NUMBERS} {FILES} {TEXT}"),
    room("server/motiongen_server/engine", "numpy motiongen_server.engine", never="asyncio"),
    room(
        "server/motiongen_server/runner",
        f"{NUMBERS} ardy motiongen_server.runner motiongen_server.engine.types motiongen_server.engine.ports",
        never="asyncio",
    ),
    room(
        "server/motiongen_server/convert server/motiongen_server/convert.py",
        "numpy motiongen motiongen_server.abilities motiongen_server.catalog motiongen_server.convert motiongen_server.engine.types motiongen_server.errors "
        "motiongen_server.limits",
    ),
    room(
        "server/motiongen_server/catalog.py",
        "motiongen motiongen_server.abilities motiongen_server.engine.types motiongen_server.limits motiongen_server.presets",
    ),
    room("server/motiongen_server/abilities.py", "numpy motiongen_server.engine.types"),
    room("server/motiongen_server/presets.py", "motiongen_server.engine.types"),
    room(
        "server/motiongen_server/outbox.py server/motiongen_server/rate.py server/motiongen_server/limits.py",
        "motiongen_server.engine.types",
    ),
    room("server/motiongen_server/ops.py", "starlette uvicorn prometheus_client"),
    room(
        "server/motiongen_server/metrics.py server/motiongen_server/model_metrics.py",
        "prometheus_client motiongen_server.engine motiongen_server.model_metrics",
    ),
    room(
        "server/motiongen_server/config.py server/motiongen_server/settings.py",
        "_typeshed motiongen_server.errors motiongen_server.settings",
    ),
    room("server/motiongen_server/errors.py", "grpc grpc_status google motiongen_server.engine.types"),
    room("server/motiongen_server/prompts.py", "numpy motiongen_server.engine.types motiongen_server.errors"),
    room("server/motiongen_server/app.py server/motiongen_server/__main__.py", f"{GRPC} google motiongen server"),
    room("server/motiongen_server/loading.py server/motiongen_server/repertoire.py", f"{NUMBERS} ardy server"),
    room(
        "server/motiongen_server/encoder",
        f"{GRPC} motiongen_ardy.text google motiongen numpy prometheus_client server torch",
    ),
    room("server/motiongen_server/split", "msgpack numpy zmq server", never="asyncio"),
    room("server", "grpc google motiongen numpy server"),
    room(
        "client/tools/motiongen_tools/bench",
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
        ("ardy/motiongen_ardy/text/gradio.py", "import grpc"),
        ("ardy/motiongen_ardy/text/gradio.py", "from motiongen_server.engine import types"),
        ("server/motiongen_server/engine/session.py", "import torch"),
        ("server/motiongen_server/engine/session.py", "import asyncio"),
        ("server/motiongen_server/engine/session.py", "from motiongen_server import runner"),
        ("server/motiongen_server/engine/session.py", "from .. import convert"),
        ("server/motiongen_server/engine/session.py", "def late():\n    from motiongen.v1 import session_pb2"),
        ("server/motiongen_server/service.py", "import motiongen_ardy.rollout"),
        ("server/motiongen_server/service.py", "import zmq"),
        ("server/motiongen_server/split/messages.py", "import grpc"),
        ("server/motiongen_server/convert.py", "import grpc"),
        ("server/motiongen_server/runner/row.py", "from motiongen.v1 import motion_pb2"),
        ("client/python/motiongen_client/session.py", "import torch"),
        ("client/python/motiongen_client/session.py", "import motiongen_server.config"),
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
