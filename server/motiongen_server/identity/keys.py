"""Keys of an issuer: read from a file, or fetched, kept, and fetched again before they are old or when one is new."""

from __future__ import annotations

import json
import logging
import ssl
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from http.client import HTTPException
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from jwt import PyJWK, PyJWKClient
from jwt.exceptions import PyJWTError

from motiongen_server.identity.issuers import KeySource, check_url
from motiongen_server.identity.tls import check_authorities
from motiongen_server.identity.watched import Watched

_log = logging.getLogger(__name__)

FETCH_TIMEOUT_S = 5.0
RETRY_S = 10.0
"""Least time between two fetches: tokens of made-up keys cannot have the issuer asked more often."""
MOST_WAITING = 64
"""Calls that may wait for one fetch; more are decided by what is known."""

KeysById: TypeAlias = dict[str, PyJWK]


class KeysUnavailable(Exception):
    """Nothing is known of a key: none came from the issuer, or they are too old, or newer ones cannot be had."""


class Keys(Protocol):
    """An issuer's public keys at present. key_id: "" where a token names none."""

    def find(self, key_id: str) -> PyJWK | None:
        """The key of that name; without one, the only key there is. Raises KeysUnavailable."""

    def wanted(self, key_id: str) -> Future[None] | None:
        """What is worth waiting for before `find` is asked."""

    def look(self) -> None:
        """See whether they have changed, or have to be fetched."""


class FileKeys:
    """Of a file, read anew when it changes."""

    def __init__(self, path: str) -> None:
        """Raises ValueError, and OSError where it cannot be read."""
        self._watched = Watched(f"keys {path}", [path], lambda: keys_of(json.loads(Path(path).read_bytes())))

    def find(self, key_id: str) -> PyJWK | None:
        return _find(self._watched.value, key_id)

    def wanted(self, key_id: str) -> None:
        return None

    def look(self) -> None:
        self._watched.look()


def in_thread(work: Callable[[], None]) -> None:
    """Begin work beside the caller's; it does not keep the process from ending."""
    threading.Thread(target=work, name="issuer keys", daemon=True).start()


class FetchedKeys:
    """Of a URL. While they cannot be fetched, those that were hold for `stale_s`. Used from any thread."""

    def __init__(
        self,
        source: KeySource,
        fetch: Callable[[], KeysById] | None = None,
        clock: Callable[[], float] = time.monotonic,
        begin: Callable[[Callable[[], None]], None] = in_thread,
    ) -> None:
        """fetch: the keys as they are now; raises ValueError or OSError. begin: has it done on another thread."""
        self._source = source
        self._fetch = fetch or (lambda: fetched(source))
        self._clock = clock
        self._begin = begin
        self._lock = threading.Lock()
        self._keys: KeysById | None = None
        self._fetched_at = 0.0
        self._tried_at: float | None = None
        self._under_way: Future[None] | None = None
        self._num_waiting = 0
        self._is_failing = False

    def find(self, key_id: str) -> PyJWK | None:
        age_s = self._clock() - self._fetched_at
        if self._keys is None or age_s > self._source.refresh_s + self._source.stale_s:
            raise KeysUnavailable(self._source.place)
        found = _find(self._keys, key_id)
        if found is None and self._is_failing:  # it may be a new one, of which nothing has been heard
            raise KeysUnavailable(self._source.place)
        return found

    def wanted(self, key_id: str) -> Future[None] | None:
        with self._lock:
            if not self._is_due() and _find(self._keys or {}, key_id) is not None:
                return None
            under_way = self._ask()
            if under_way is None or self._num_waiting >= MOST_WAITING:
                return None
            self._num_waiting += 1
            return under_way

    def look(self) -> None:
        with self._lock:
            if self._is_due():
                self._ask()

    def _is_due(self) -> bool:
        return self._keys is None or self._clock() - self._fetched_at > self._source.refresh_s

    def _ask(self) -> Future[None] | None:
        """The fetch that is under way, begun now unless the last was just before."""
        if self._under_way is not None:
            return self._under_way
        now = self._clock()
        if self._tried_at is not None and now - self._tried_at < RETRY_S:
            return None
        self._tried_at, self._num_waiting = now, 0
        under_way = self._under_way = Future[None]()
        self._begin(lambda: self._renew(under_way))
        return under_way

    def _renew(self, under_way: Future[None]) -> None:
        try:
            keys = self._fetch()
        except (OSError, ValueError) as error:
            if not self._is_failing:
                _log.error("keys of %s cannot be fetched, those that were hold for a while: %s",
                           self._source.place, error)  # fmt: skip
            self._is_failing = True
        else:
            if self._is_failing or self._keys is None or keys.keys() != self._keys.keys():
                _log.info("keys of %s: %s", self._source.place, ", ".join(sorted(keys)) or "none")
            self._keys, self._fetched_at, self._is_failing = keys, self._clock(), False
        finally:
            self._under_way = None
            under_way.set_result(None)


class KeyRings:
    """The keys of all issuers, which outlive a change of the file that names them."""

    def __init__(self, begin: Callable[[Callable[[], None]], None] = in_thread) -> None:
        self._begin = begin
        self._keys: dict[KeySource, Keys] = {}

    def of(self, source: KeySource) -> Keys:
        """Raises ValueError, or OSError, for a file that cannot be read."""
        found = self._keys.get(source)
        if found is None:
            if source.authority:
                check_authorities(source.authority)
            found = FetchedKeys(source, begin=self._begin) if source.is_url else FileKeys(source.place)
            self._keys[source] = found
        return found


def keys_of(document: object) -> KeysById:
    """The keys of a JSON Web Key Set (RFC 7517) that tokens may be signed with. Raises ValueError where it is none."""
    keys = document.get("keys") if isinstance(document, Mapping) else None
    if not isinstance(keys, list):
        raise ValueError("it is no set of keys; it must be an object with a list of `keys` (RFC 7517)")
    found: KeysById = {}
    for key in keys:
        # A key that is shared, or to encrypt with, must not let a token pass; one of another kind is for others.
        if not isinstance(key, Mapping) or key.get("kty") == "oct" or key.get("use", "sig") != "sig":
            continue
        try:
            found[str(key.get("kid", ""))] = PyJWK(dict(key))
        except PyJWTError as error:
            _log.debug("a key is passed over: %s", error)
    return found


def fetched(source: KeySource) -> KeysById:
    """The keys of a source that is a URL. Raises ValueError, and OSError where it is not reached."""
    place = source.place
    if source.is_discovery:
        place = str(_answer(place, source).get("jwks_uri"))
        check_url(place, f"jwks_uri of {source.place}")
    return keys_of(_answer(place, source))


def _answer(url: str, source: KeySource) -> Mapping[str, Any]:
    context = ssl.create_default_context(cafile=source.authority or None)
    client = PyJWKClient(url, cache_jwk_set=False, timeout=FETCH_TIMEOUT_S, ssl_context=context)
    try:
        answer: object = client.fetch_data()
    except (PyJWTError, HTTPException) as error:  # the latter of an answer that breaks off, or is no HTTP
        raise ValueError(f"{url} does not answer: {error!r}") from error
    if not isinstance(answer, Mapping):
        raise ValueError(f"{url} answers with no object of JSON")
    return answer


def _find(keys: Mapping[str, PyJWK], key_id: str) -> PyJWK | None:
    if not key_id and len(keys) == 1:
        return next(iter(keys.values()))
    return keys.get(key_id)
