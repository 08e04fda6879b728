"""A hub in this process: serves one repository's files the way huggingface.co does, and fails on demand."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from pathlib import Path

from tests import http_serving

COMMIT = "0123456789abcdef0123456789abcdef01234567"
BRANCHES = ("main", COMMIT, "v1")


@dataclass
class FakeHub:
    """files: path -> content in `repo_id`. refusal: (status, X-Error-Code) of every answer. cut: a path whose first
    download breaks off halfway. requests: (method, path, Range header) of all requests."""

    repo_id: str
    files: dict[str, bytes]
    refusal: tuple[int, str] | None = None
    cut: str | None = None
    requests: list[tuple[str, str, str | None]] = field(default_factory=list)
    endpoint: str = ""

    def downloads(self) -> list[str]:
        """The paths of the files that were downloaded, in whole or in part."""
        return [path.partition(f"/resolve/{COMMIT}/")[2] for kind, path, _ in self.requests
                if kind == "GET" and "/resolve/" in path]  # fmt: skip


def files_of(folder: Path) -> dict[str, bytes]:
    """The content of all files below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@contextmanager
def serving(hub: FakeHub) -> Iterator[FakeHub]:
    """Serve a hub on a free port while the context lasts."""
    with http_serving.serving(lambda *given: _Handler(hub, *given)) as hub.endpoint:
        yield hub


class _Handler(BaseHTTPRequestHandler):
    def __init__(self, hub: FakeHub, *given: object) -> None:
        self._hub = hub
        super().__init__(*given)  # type: ignore[arg-type]

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: tests read `requests`."""

    def do_HEAD(self) -> None:
        self._answer()

    def do_GET(self) -> None:
        self._answer()

    def _answer(self) -> None:
        hub, path = self._hub, self.path.partition("?")[0]
        hub.requests.append((self.command, path, self.headers.get("Range")))
        if hub.refusal is not None:
            return self._send(hub.refusal[0], b"", {"X-Error-Code": hub.refusal[1]})
        repository = re.escape(hub.repo_id)
        if match := re.fullmatch(rf"/api/models/{repository}(?:/(revision|tree)/([^/]+))?", path):
            kind, revision = match[1] or "revision", match[2] or "main"
            if revision not in BRANCHES:
                return self._send(404, b"", {"X-Error-Code": "RevisionNotFound"})
            return self._send(200, json.dumps(self._listing(kind)).encode(), {"Content-Type": "application/json"})
        if match := re.fullmatch(rf"/{repository}/resolve/{COMMIT}/(.+)", path):
            return self._send_file(match[1])
        return self._send(404, b"", {"X-Error-Code": "RepoNotFound"})

    def _listing(self, kind: str) -> object:
        if kind == "tree":
            return [{"type": "file", "oid": hashlib.sha1(content).hexdigest(), "size": len(content), "path": path}
                    for path, content in self._hub.files.items()]  # fmt: skip
        siblings = [{"rfilename": path} for path in self._hub.files]
        return {"id": self._hub.repo_id, "modelId": self._hub.repo_id, "sha": COMMIT, "siblings": siblings, "tags": []}

    def _send_file(self, path: str) -> None:
        content = self._hub.files.get(path)
        if content is None:
            return self._send(404, b"", {"X-Error-Code": "EntryNotFound"})
        headers = {"ETag": f'"{hashlib.sha1(content).hexdigest()}"', "X-Repo-Commit": COMMIT}
        start = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range") or "")
        if start:
            first = int(start[1])
            headers["Content-Range"] = f"bytes {first}-{len(content) - 1}/{len(content)}"
            return self._send(206, content[first:], headers)
        if self.command == "GET" and self._hub.cut == path:
            self._hub.cut = None
            return self._send(200, content[: len(content) // 2], headers | {"Content-Length": str(len(content))})
        return self._send(200, content, headers)

    def _send(self, status: int, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(body))} | headers).items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)
