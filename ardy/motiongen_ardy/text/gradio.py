"""Client of the text service that comes with NVIDIA's ARDY: a Gradio app that returns a file of numbers for a prompt.

Gradio's HTTP interface: a POST with the inputs to the endpoint returns an event id, a GET follows that event to its
end, and the file is fetched from the app.
"""

from __future__ import annotations

import hashlib
import json
import time
import uuid
from http.client import HTTPException
from typing import Any
from urllib.error import HTTPError
from urllib.parse import quote, urlsplit
from urllib.request import HTTPHandler, HTTPSHandler, OpenerDirector, Request

import numpy as np

from motiongen_ardy.checkpoint.npy import NpyError, read_npy
from motiongen_ardy.text.encoder import (
    EachTextEncoder,
    TextEncoderChanged,
    TextEncoderUnavailable,
    UnknownTextEncoder,
    Vectors,
    checked_vector,
)

ENDPOINT = "DemoWrapper"
PREFIX = "/gradio_api"
PROBE = "healthcheck"
MAX_ANSWER_BYTES = 1 << 20
NO_ANSWER = "the text encoder does not answer"


class GradioTextEncoder(EachTextEncoder):
    """Encodes one prompt per call. The service does not identify itself, so its vector of a fixed text is its identity.

    The identity is checked again after every failure: another service may have started at the same address.
    """

    def __init__(self, url: str, timeout_s: float = 30.0) -> None:
        """url: http or https, of the app. timeout_s: for a whole call.

        Raises UnknownTextEncoder for an invalid address, TextEncoderUnavailable if nothing answers there.
        """
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.netloc or parts.query or parts.fragment:
            raise UnknownTextEncoder(f"{url!r} is no address of a Gradio app; such as http://localhost:9550")
        self._base = url.rstrip("/")
        self._timeout_s = timeout_s
        # Not the default opener, which would also open files and follow redirections to other hosts.
        self._opener = OpenerDirector()
        self._opener.add_handler(HTTPHandler())
        self._opener.add_handler(HTTPSHandler())
        probe = self._fetch(PROBE)
        super().__init__(_identity_of(probe), len(probe))
        self._is_trusted = True

    def encode_one(self, text: str) -> Vectors:
        try:
            if not self._is_trusted:
                found = _identity_of(self._fetch(PROBE))
                if found != self._identity:
                    raise TextEncoderChanged(
                        f"the text encoder is {found} now and was {self._identity}; restart what uses it"
                    )
                self._is_trusted = True
            return checked_vector(self._fetch(text), self._width)
        except TextEncoderUnavailable:
            self._is_trusted = False
            raise

    def _fetch(self, text: str) -> Vectors:
        """(W,) for one text. Raises TextEncoderUnavailable."""
        ends_at = time.monotonic() + self._timeout_s
        try:
            answer = self._call(text, ends_at)
            content = self._read(Request(f"{self._base}{PREFIX}/file={quote(_path_in(answer))}"), ends_at)
            vector = read_npy(content)
        except (OSError, HTTPException) as error:
            if isinstance(error, TextEncoderUnavailable):
                raise
            raise TextEncoderUnavailable(f"{NO_ANSWER} ({_reason(error)})") from error
        except (NpyError, ValueError, KeyError, IndexError, TypeError, RecursionError) as error:
            raise TextEncoderChanged(f"the text encoder does not answer as ARDY's does: {error!r:.200}") from error
        return checked_vector(vector, vector.shape[-1] if vector.ndim else 0)

    def _call(self, text: str, ends_at: float) -> Any:
        """What the endpoint returns for the text."""
        url = f"{self._base}{PREFIX}/call/{ENDPOINT}"
        body = json.dumps({"data": [text, f"{uuid.uuid4()}.npy"]}).encode()
        started = self._read(Request(url, body, {"Content-Type": "application/json"}), ends_at)
        event_id = str(json.loads(started)["event_id"])
        event, data = "", ""
        with self._opener.open(Request(f"{url}/{quote(event_id, safe='')}"), timeout=_left(ends_at)) as stream:
            _check_status(stream)
            num_bytes = 0
            while line := stream.readline(MAX_ANSWER_BYTES):
                num_bytes += len(line)
                if num_bytes > MAX_ANSWER_BYTES:
                    raise ValueError(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
                _left(ends_at)  # heartbeats alone are not an answer
                name, _, value = line.decode().rstrip("\r\n").partition(": ")
                if name == "event":
                    event = value
                elif name == "data":
                    data = value
                if name == "data" and event in ("complete", "error"):
                    break
        if event != "complete":
            raise TextEncoderUnavailable(f"the text encoder failed: {data[:200] or 'it gave no answer'}")
        return json.loads(data)

    def _read(self, request: Request, ends_at: float) -> bytes:
        with self._opener.open(request, timeout=_left(ends_at)) as response:
            _check_status(response)
            content: bytes = response.read(MAX_ANSWER_BYTES + 1)
        if len(content) > MAX_ANSWER_BYTES:
            raise ValueError(f"an answer of more than {MAX_ANSWER_BYTES} bytes")
        return content


def _identity_of(probe: Vectors) -> str:
    return f"gradio-{hashlib.sha256(np.ascontiguousarray(probe, '<f4').tobytes()).hexdigest()[:12]}"


def _path_in(answer: Any) -> str:
    """The path of the file in the first result, which is the file itself or an update of the download button."""
    first = answer[0]
    if "value" in first:
        first = first["value"]
    path = first["path"]
    if not isinstance(path, str) or not path:
        raise ValueError("a file without a path")
    return path


def _left(ends_at: float) -> float:
    """Seconds left until then. Raises TimeoutError if there are none."""
    left = ends_at - time.monotonic()
    if left <= 0:
        raise TimeoutError
    return left


def _check_status(response: Any) -> None:
    if response.status != 200:
        raise HTTPError(response.url, response.status, response.reason, response.headers, None)


def _reason(error: Exception) -> str:
    """Why a call failed, without the address."""
    if isinstance(error, HTTPError):
        return f"HTTP status {error.code}"
    inner = getattr(error, "reason", error)
    if isinstance(inner, TimeoutError):
        return "it takes too long"
    return type(inner).__name__
