"""A Gradio app in this process: the text service of ARDY as its clients see it, failing on demand.

Its answers have the form of gradio 6.31's; they were compared with that.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from typing import Any

import numpy as np

from tests import http_serving

WIDTH = 8


def vector_of(text: str) -> np.ndarray:
    """(1, WIDTH) float32, different for every text."""
    return np.random.default_rng(list(text.encode())).standard_normal((1, WIDTH)).astype(np.float32)


@dataclass
class FakeGradio:
    """texts: those received. fate: "" to answer; "error" to fail inside; "silent" to send only heartbeats; "down" to
    answer with status 502. encode: makes the vector; result: makes the endpoint's results from the file's path."""

    encode: Callable[[str], np.ndarray] = vector_of
    fate: str = ""
    content: bytes | None = None
    result: Callable[[str], Any] | None = None
    texts: list[str] = field(default_factory=list)
    file_names: list[str] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)
    events: dict[str, str] = field(default_factory=dict)
    url: str = ""


@contextmanager
def serving(app: FakeGradio) -> Iterator[FakeGradio]:
    """Serve the app on a free port while the context lasts."""
    with http_serving.serving(lambda *given: _Handler(app, *given)) as url:
        app.url = f"{url}/"
        yield app


class _Handler(BaseHTTPRequestHandler):
    def __init__(self, app: FakeGradio, *given: object) -> None:
        self._app = app
        super().__init__(*given)  # type: ignore[arg-type]

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing to the terminal."""

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if self.path != "/gradio_api/call/DemoWrapper" or self._app.fate == "down":
            return self._answer(502, b"bad gateway")
        text, name = body["data"]
        self._app.texts.append(text)
        self._app.file_names.append(name)
        self._app.events[event := f"event{len(self._app.events)}"] = text
        file = io.BytesIO()
        np.save(file, self._app.encode(text))
        self._app.files[f"/kept/{event}/{name}"] = file.getvalue()
        return self._answer(200, json.dumps({"event_id": event}).encode())

    def do_GET(self) -> None:
        call, _, event = self.path.rpartition("/")
        if call == "/gradio_api/call/DemoWrapper":
            return self._tell(event)
        path = self.path.removeprefix("/gradio_api/file=")
        if path not in self._app.files:
            return self._answer(404, b"")
        return self._answer(200, self._app.files[path] if self._app.content is None else self._app.content)

    def _tell(self, event: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream; charset=utf-8")
        self.end_headers()
        if self._app.fate == "error":
            self.wfile.write(b'event: error\ndata: {"error": null}\n\n')
            return
        try:
            while self._app.fate == "silent":
                self.wfile.write(b"event: heartbeat\ndata: null\n\n")
        except OSError:
            return  # the client has given up
        path = next(path for path in self._app.files if f"/{event}/" in path)
        results = (self._app.result or _results)(path)
        self.wfile.write(b"event: heartbeat\ndata: null\n\n")
        self.wfile.write(f"event: complete\ndata: {json.dumps(results)}\n\n".encode())

    def _answer(self, status: int, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


def _results(path: str) -> list[Any]:
    """The results of a download button and two texts: the button's is an update, with the file in its value."""
    file = {
        "path": path,
        "url": f"http://elsewhere.invalid/gradio_api/file={path}",
        "size": None,
        "orig_name": "name.npy",
        "mime_type": None,
        "is_stream": False,
        "meta": {"_type": "gradio.FileData"},
    }
    button = {"visible": True, "label": "Download", "value": file, "__type__": "update"}
    return [button, {"value": "encoded", "__type__": "update"}, "(1, 8)"]
