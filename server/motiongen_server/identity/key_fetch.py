"""Fetches an issuer's keys over HTTP, with limits of time and size, and from nobody but the issuer."""

from __future__ import annotations

import io
import json
import socket
import ssl
import time
from base64 import b64encode
from collections.abc import Mapping
from functools import partial
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from typing import Any
from urllib.parse import SplitResult, unquote, urlsplit
from urllib.request import getproxies, proxy_bypass

from motiongen_server.addresses import is_local
from motiongen_server.identity.issuers import KeySource, check_url
from motiongen_server.identity.key_set import KeysById, keys_of

WITHIN_S = 10.0
"""For the whole fetch, which takes two requests if keys are found by discovery."""
CONNECT_WITHIN_S = 5.0
MOST_BYTES = 1 << 20
"""In one answer; a set of ten keys has 5 KB."""


def fetched(source: KeySource, within_s: float = WITHIN_S) -> KeysById:
    """The keys of a source that is a URL. Raises ValueError if they cannot be fetched."""
    ends_at, place = time.monotonic() + within_s, source.place
    if source.is_discovery:
        place = str(_answer(place, source, ends_at).get("jwks_uri"))
        check_url(place, f"jwks_uri of {source.place}")
    return keys_of(_answer(place, source, ends_at))


def _answer(url: str, source: KeySource, ends_at: float) -> Mapping[str, Any]:
    """The JSON object at a URL. ends_at: monotonic seconds. Does not follow redirects. Raises ValueError."""
    try:
        answer = json.loads(_body(urlsplit(url), source, ends_at))
    except (OSError, HTTPException) as error:  # HTTPException: the answer breaks off, or is not HTTP
        raise ValueError(f"{url} does not answer: {error!r}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{url} does not answer with keys: {error}") from error
    if not isinstance(answer, Mapping):
        raise ValueError(f"{url} does not answer with a JSON object")
    return answer


def _body(url: SplitResult, source: KeySource, ends_at: float) -> bytes:
    line = _line(url, source)
    line.response_class = partial(_Response, ends_at)  # type: ignore[assignment]  # called as the class would be
    try:
        target = f"{url.path or '/'}?{url.query}" if url.query else url.path or "/"
        line.request("GET", target, headers={"Accept": "application/json", "User-Agent": "motiongen"})
        with line.getresponse() as response:
            if response.status != HTTPStatus.OK:
                raise ValueError(f"its status is {response.status}")
            body = response.read(MOST_BYTES + 1)
    finally:
        line.close()
    if len(body) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES} bytes")
    return body


def _line(url: SplitResult, source: KeySource) -> HTTPConnection:
    """A connection that is not open yet.

    A proxy named by the environment is used only for https to other machines: it can neither read nor change that.
    """
    host = url.hostname or ""
    if url.scheme == "http":
        return HTTPConnection(host, url.port, timeout=CONNECT_WITHIN_S)
    context = ssl.create_default_context(cafile=source.authority or None)
    named = getproxies().get("https", "")
    if not named or is_local(host) or proxy_bypass(url.netloc):
        return HTTPSConnection(host, url.port, timeout=CONNECT_WITHIN_S, context=context)
    proxy = urlsplit(named if "://" in named else f"//{named}")
    line = HTTPSConnection(proxy.hostname or "", proxy.port, timeout=CONNECT_WITHIN_S, context=context)
    line.set_tunnel(host, url.port, _to_proxy(proxy))
    return line


def _to_proxy(proxy: SplitResult) -> dict[str, str]:
    if proxy.username is None:
        return {}
    shown = f"{unquote(proxy.username)}:{unquote(proxy.password or '')}"
    return {"Proxy-Authorization": f"Basic {b64encode(shown.encode()).decode()}"}


class _Response(HTTPResponse):
    """A response with a deadline: otherwise a server that sends a byte a second would block the thread for ever."""

    def __init__(self, ends_at: float, line: socket.socket, *more: Any, **named: Any) -> None:
        """ends_at: monotonic seconds. The other arguments are those of HTTPResponse."""
        super().__init__(line, *more, **named)
        self.fp = io.BufferedReader(_Received(line, self.fp.detach(), ends_at))


class _Received(io.RawIOBase):
    """What a socket receives. Raises TimeoutError after the deadline."""

    def __init__(self, line: socket.socket, received: io.RawIOBase, ends_at: float) -> None:
        self._line = line
        self._received = received
        self._ends_at = ends_at

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        left_s = self._ends_at - time.monotonic()
        if left_s <= 0:
            raise TimeoutError("the answer did not arrive in time")
        self._line.settimeout(left_s)
        return self._received.readinto(buffer)

    def close(self) -> None:
        self._received.close()
        super().close()
