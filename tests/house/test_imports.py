"""The import rules of ARCHITECTURE.md: which room may import what, checked in the source of every file."""

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
    allowed = may.replace("~", "motiongen_server").split()
    return Room(tuple(paths.split()), frozenset(allowed), frozenset(never.split()))


NUMBERS = "numpy torch"
FILES = "huggingface_hub safetensors yaml"
TEXT = "model2vec tokenizers"
PICTURES = "matplotlib"
GRPC = "grpc grpc_health grpc_reflection"

PARTS = ("ardy", "server", "client/python", "client/tools", "compliance", "proto/python")
ARDY = "ardy/motiongen_ardy"
SERVER = "server/motiongen_server"

CALLS = (
    "grpc google.protobuf ~.rpc.calls ~.rpc.grpc_server ~.rpc.budgets ~.rpc.errors ~.rpc.limits ~.errors"
    " ~.engine.types ~.identity"
)
SESSIONS = (
    "numpy motiongen ~.rpc.sessions ~.rpc.convert ~.rpc.budgets ~.rpc.errors ~.rpc.limits ~.rpc.send_queue"
    " ~.rpc.sparing_log ~.rpc.stream_metrics ~.errors ~.engine.types ~.models.registry ~.snapshots ~.text"
)
STREAMS = "grpc ~.rpc.streams ~.rpc.calls ~.rpc.handlers ~.rpc.request_parts ~.rpc.wire_fields ~.identity ~.replicas"

# The first room that holds a file decides. `~` in `may` stands for the server's own package.
ROOMS = (
    room("proto/generate.py", "google grpc_tools"),
    room("proto/python", "google grpc motiongen"),
    # the model library: core knows only itself, model knows core, checkpoint both
    room(f"{ARDY}/core", f"motiongen_ardy.core {NUMBERS}"),
    room(f"{ARDY}/locomotion", "motiongen_ardy.locomotion numpy"),
    room(f"{ARDY}/model/packed/kernels.py", "triton"),
    room(f"{ARDY}/model", f"motiongen_ardy.core motiongen_ardy.locomotion motiongen_ardy.model {NUMBERS}"),
    room(f"{ARDY}/checkpoint", f"motiongen_ardy.core motiongen_ardy.model motiongen_ardy.checkpoint {NUMBERS} {FILES}"),
    room(
        f"{ARDY}/data {ARDY}/train {ARDY}/evaluate",
        f"motiongen_ardy {NUMBERS} {FILES} {TEXT} {PICTURES} rich tensorboard transformers",
    ),
    room(f"{ARDY}/text", f"motiongen_ardy {NUMBERS} {FILES} {TEXT} peft transformers"),
    room(f"{ARDY}/formats", f"motiongen_ardy {NUMBERS} pygltflib"),
    room(ARDY, f"motiongen_ardy {NUMBERS} {FILES} {TEXT}"),
    # the server
    room(f"{SERVER}/engine/types", "numpy ~.engine.types", never="asyncio"),
    room(f"{SERVER}/engine/ports.py {SERVER}/engine/engine_port.py", "~.engine.types", never="asyncio"),
    room(f"{SERVER}/engine", "numpy motiongen_ardy.locomotion ~.engine", never="asyncio"),
    room(f"{SERVER}/runner", f"{NUMBERS} motiongen_ardy ~.runner ~.engine.types ~.engine.ports", never="asyncio"),
    room(f"{SERVER}/engine_process/model_loading.py", "torch motiongen_ardy ~", never="asyncio"),
    room(
        f"{SERVER}/engine_process",
        "msgpack numpy zmq ~.engine ~.engine_process ~.ops ~.config ~.devices ~.settings"
        " ~.rpc.abilities ~.text.ports ~.models.loader",
        never="asyncio",
    ),
    room(
        f"{SERVER}/rpc/convert",
        "google.protobuf numpy motiongen ~.engine.types ~.errors ~.replicas.hint"
        " ~.rpc.abilities ~.rpc.catalog ~.rpc.convert ~.rpc.limits",
    ),
    room(f"{SERVER}/rpc/catalog.py", "motiongen ~.rpc.abilities ~.engine.types ~.rpc.limits ~.text.presets"),
    room(f"{SERVER}/rpc/abilities.py", "numpy ~.engine.types"),
    room(f"{SERVER}/rpc/send_queue.py {SERVER}/rpc/budgets/token_bucket.py {SERVER}/rpc/limits.py", "~.engine.types"),
    # errors import none of these, budgets errors, calls and sessions budgets, streams sessions, the servicer all
    room(f"{SERVER}/rpc/errors", "grpc ~.errors ~.engine.types ~.rpc.errors"),
    room(
        f"{SERVER}/rpc/budgets",
        "~.rpc.budgets ~.rpc.errors ~.rpc.limits ~.engine.types ~.errors ~.identity ~.addresses",
    ),
    room(f"{SERVER}/rpc/calls/health.py", f"grpc_health {CALLS}"),
    room(f"{SERVER}/rpc/calls/reflection.py", f"grpc_reflection {CALLS}"),
    room(f"{SERVER}/rpc/calls", CALLS),
    room(f"{SERVER}/rpc/sessions", SESSIONS),
    room(f"{SERVER}/rpc/streams", f"{STREAMS} {SESSIONS}"),
    room(
        f"{SERVER}/rpc",
        "grpc google motiongen numpy ~.rpc ~.text ~.errors ~.config"
        " ~.engine.types ~.engine.engine_port ~.models.registry ~.identity ~.snapshots ~.replicas",
    ),
    room(
        f"{SERVER}/snapshots",
        "numpy redis ~.snapshots ~.engine.types ~.engine_process.codec ~.settings",
        never="asyncio",
    ),
    room(f"{SERVER}/replicas", "~.replicas ~.snapshots ~.engine.types", never="asyncio"),
    room(f"{SERVER}/text/presets.py", "~.engine.types"),
    room(f"{SERVER}/text/event_errors.py", "~.engine.types ~.errors"),
    room(f"{SERVER}/text/ports.py", "numpy", never="asyncio"),
    room(f"{SERVER}/text/kept.py", "~.text.ports"),
    room(f"{SERVER}/text/prompts.py", "~.errors ~.text.event_errors ~.text.kept ~.text.ports ~.text.turns"),
    room(
        f"{SERVER}/text/encoder",
        f"{GRPC} google motiongen motiongen_ardy.text numpy prometheus_client torch"
        " ~.text ~.ops ~.errors ~.addresses ~.config ~.settings ~.background ~.engine.types"
        " ~.identity ~.protection ~.rpc.calls ~.rpc.limits ~.rpc.budgets ~.rpc.grpc_server ~.transport",
    ),
    room(f"{SERVER}/models/loader.py", "motiongen_ardy.text ~"),
    room(f"{SERVER}/models/repertoire.py", "numpy motiongen_ardy.capabilities ~"),
    room(f"{SERVER}/models", "grpc google motiongen numpy ~"),
    room(f"{SERVER}/ops/http.py", "h11 starlette uvicorn prometheus_client ~.ops.pace"),
    room(f"{SERVER}/ops/port.py", "starlette ~.ops ~.addresses ~.settings"),
    room(
        f"{SERVER}/ops/tracing.py", "opentelemetry ~.engine.types ~.addresses ~.collector ~.settings", never="asyncio"
    ),
    room(f"{SERVER}/ops", "prometheus_client ~.ops ~.engine"),
    room(
        f"{SERVER}/config.py {SERVER}/devices.py {SERVER}/settings.py {SERVER}/addresses.py {SERVER}/protection.py"
        f" {SERVER}/collector.py"
        f" {SERVER}/processor_quota.py",
        "_typeshed ~.collector ~.addresses ~.devices ~.processor_quota ~.protection ~.settings",
    ),
    room(f"{SERVER}/ready.py", "~.addresses ~.config ~.settings ~.text.encoder.config"),
    room(f"{SERVER}/identity/setup.py", "grpc ~.identity ~.addresses ~.protection ~.settings", never="asyncio"),
    room(f"{SERVER}/identity", "grpc jwt ~.identity ~.errors ~.settings ~.addresses", never="asyncio"),
    room(f"{SERVER}/errors.py", "grpc grpc_status google ~.engine.types"),
    room(f"{SERVER}/transport.py", "grpc ~.config ~.settings ~.rpc.calls.call_pace ~.rpc.grpc_server ~.rpc.limits"),
    room(
        f"{SERVER}/grpc_port.py",
        f"{GRPC} ~.addresses ~.config ~.identity.setup ~.identity.tls ~.rpc.handlers ~.rpc.calls ~.settings"
        " ~.transport",
    ),
    room(f"{SERVER}/app.py {SERVER}/run.py {SERVER}/__main__.py", f"{GRPC} google motiongen ~"),
    room(SERVER, ""),
    # the clients
    room("client/python/motiongen_client", "google grpc motiongen numpy motiongen_client"),
    room(
        "client/tools/motiongen_tools/bench",
        "google grpc motiongen numpy motiongen_client motiongen_tools hdrh matplotlib psutil rich yaml",
    ),
    room(
        "client/tools/motiongen_tools/view client/tools/motiongen_tools/cli_view.py",
        "grpc numpy motiongen_client motiongen_tools rich starlette uvicorn",
    ),
    room("client/tools", "google grpc motiongen numpy motiongen_client motiongen_tools matplotlib rich"),
    # the compliance suite; its conftest.py brings the servers of this repository
    room(
        "compliance/motiongen_compliance",
        "google.rpc grpc grpc_status motiongen numpy pytest motiongen_compliance",
    ),
    room("compliance/conftest.py", "pytest motiongen_server tests"),
    room("client/python/examples", "numpy motiongen_client"),
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
    package = ".".join(Path(path).relative_to(part_of(path)).parent.parts)
    found = []
    for line, module in imported_modules(source, package):
        root = module.partition(".")[0]
        allowed = is_below(module, rule.may) or (root in STANDARD and not is_below(module, rule.never))
        if not allowed:
            found.append(f"{path}:{line} imports {module}; its room may import {sorted(rule.may)}")
    return found


def part_of(path: str) -> str:
    """The folder that a file's dotted name starts below; "" for a file outside the parts."""
    return next((part for part in PARTS if path.startswith(part + "/")), "")


def is_below(module: str, names: frozenset[str]) -> bool:
    return any(module == name or module.startswith(name + ".") for name in names)


def room_of(path: Path) -> Room | None:
    for candidate in ROOMS:
        if any(path == Path(place) or Path(place) in path.parents for place in candidate.paths):
            return candidate
    return None


def test_every_import_is_allowed(repository: Any) -> None:
    found = []
    for path in repository.files:
        rule = room_of(path) if path.suffix == ".py" else None
        if rule is not None:
            found += breaches((repository.root / path).read_text(encoding="utf-8"), path.as_posix(), rule)
    assert found == []


def test_every_source_file_is_in_a_room(repository: Any) -> None:
    tops = {"proto", "ardy", "server", "client", "compliance"}
    homeless = [str(p) for p in repository.files if p.suffix == ".py" and p.parts[0] in tops and room_of(p) is None]
    assert homeless == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("ardy/motiongen_ardy/text/gradio.py", "import grpc"),
        ("ardy/motiongen_ardy/text/gradio.py", "from motiongen_server.engine import types"),
        ("server/motiongen_server/engine/ports.py", "import motiongen_server.engine.scheduling.costs"),
        ("server/motiongen_server/engine/session/session.py", "import torch"),
        ("server/motiongen_server/engine/session/session.py", "from motiongen_ardy.core import skeleton"),
        ("ardy/motiongen_ardy/locomotion/velocity.py", "import torch"),
        ("server/motiongen_server/engine/session/session.py", "import asyncio"),
        ("server/motiongen_server/engine/session/session.py", "from motiongen_server import runner"),
        ("server/motiongen_server/engine/session/session.py", "from ... import rpc"),
        ("server/motiongen_server/engine/session/session.py", "def late():\n    from motiongen.v1 import session_pb2"),
        ("server/motiongen_server/rpc/service.py", "import motiongen_ardy.model.rollout"),
        ("server/motiongen_server/rpc/service.py", "import zmq"),
        ("server/motiongen_server/engine_process/messages.py", "import grpc"),
        ("server/motiongen_server/engine_process/host.py", "import torch"),
        ("server/motiongen_server/models/loader.py", "import torch"),
        ("server/motiongen_server/rpc/convert/events.py", "import grpc"),
        ("server/motiongen_server/runner/row.py", "from motiongen.v1 import motion_pb2"),
        ("client/python/motiongen_client/session.py", "import torch"),
        ("client/python/motiongen_client/session.py", "import motiongen_server.config"),
        ("compliance/motiongen_compliance/suite/test_greed.py", "from motiongen_server.rpc import limits"),
        ("compliance/motiongen_compliance/talk.py", "import motiongen_client"),
        ("proto/python/motiongen/__init__.py", "import motiongen_ardy"),
    ],
)
def test_forbidden_import_is_found(path: str, source: str) -> None:
    rule = room_of(Path(path))
    assert rule is not None
    assert breaches(source, path, rule)


def test_importing_the_client_loads_no_torch(repository: Any) -> None:
    code = "import sys, motiongen_client, motiongen_client.blocking; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=repository.root
    )
    roots = {name.partition(".")[0] for name in loaded.stdout.split()}
    assert "grpc" in roots
    ours = {"motiongen_ardy", "motiongen_server", "motiongen_tools"}
    assert not roots & (ours | {"torch", "hdrh", "matplotlib", "psutil", "rich", "yaml"})


@pytest.mark.parametrize(
    ("module", "never"),
    [
        ("motiongen_server.app", {"torch"}),
        ("motiongen_server.engine_process.__main__", {"grpc", "motiongen", "asyncio", "torch"}),
    ],
)
def test_gateway_loads_no_torch_and_an_engine_process_no_grpc(repository: Any, module: str, never: set[str]) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=repository.root
    )
    roots = {name.partition(".")[0] for name in loaded.stdout.split()}
    assert "motiongen_server" in roots
    assert not roots & never
