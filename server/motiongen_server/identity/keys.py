"""An issuer's keys: read from a file, or fetched, cached, and fetched again when they are old or a new key is used."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Protocol

from motiongen_server.identity.issuers import KeySource
from motiongen_server.identity.key_fetch import WITHIN_S, fetched
from motiongen_server.identity.key_set import Key, KeysById, find_key, is_told, keys_of
from motiongen_server.identity.tls import check_authorities
from motiongen_server.identity.watched import Watched

_log = logging.getLogger(__name__)

GIVE_UP_S = 2 * WITHIN_S
"""After this time a fetch counts as failed, whatever its thread waits for, and another may begin."""
RETRY_S = 10.0
"""Least time between fetches if one failed or is not due: tokens that name invented keys must not cause more requests
to the issuer."""
MOST_WAITING = 64
"""Calls that may wait for one fetch; further calls are decided with the keys at hand."""


class KeysUnavailable(Exception):
    """A key cannot be judged: no keys have been fetched yet, they are too old, or fetching newer ones fails."""


class Keys(Protocol):
    """An issuer's current public keys. key_id: "" if a token names none."""

    def find(self, key_id: str) -> Key | None:
        """The key with that id; if `key_id` is "", the only key there is. Raises KeysUnavailable."""

    def tells(self, key: Key) -> bool:
        """Whether the issuer still publishes a key. Raises KeysUnavailable."""

    def wanted(self, key_id: str) -> Future[None] | None:
        """A fetch that should finish before `find` is called; None: call it at once."""

    def look(self) -> None:
        """Read the keys again if their file has changed, or begin to fetch them if that is due."""


class FileKeys:
    """Keys from a file, which is read again when it changes."""

    def __init__(self, path: str) -> None:
        """Raises ValueError if the file holds no keys, OSError if it cannot be read."""
        self._watched = Watched(f"keys {path}", [path], lambda: _read(path))

    def find(self, key_id: str) -> Key | None:
        return find_key(self._watched.value, key_id)

    def tells(self, key: Key) -> bool:
        return is_told(self._watched.value, key)

    def wanted(self, key_id: str) -> None:
        return None

    def look(self) -> None:
        self._watched.look()


def _read(path: str) -> KeysById:
    try:
        return keys_of(json.loads(Path(path).read_bytes()))
    except RecursionError as error:
        raise ValueError(f"{path} is not a set of keys; its lists are nested too deeply") from error


def in_thread(work: Callable[[], None]) -> None:
    """Run `work` on a daemon thread."""
    threading.Thread(target=work, name="issuer keys", daemon=True).start()


class FetchedKeys:
    """Keys from a URL. If fetching fails, the last keys stay valid for `stale_s` longer. Used from any thread."""

    def __init__(
        self,
        source: KeySource,
        fetch: Callable[[], KeysById] | None = None,
        clock: Callable[[], float] = time.monotonic,
        begin: Callable[[Callable[[], None]], None] = in_thread,
    ) -> None:
        """fetch: returns the issuer's current keys; raises ValueError or OSError. begin: runs it on another thread."""
        self._source = source
        self._fetch = fetch or (lambda: fetched(source))
        self._clock = clock
        self._begin = begin
        self._lock = threading.Lock()
        self._keys: KeysById | None = None
        self._fetched_at = 0.0
        self._tried_at: float | None = None
        self._under_way: Future[None] | None = None  # since `_tried_at`
        self._num_waiting = 0
        self._is_failing = False

    def find(self, key_id: str) -> Key | None:
        found = find_key(self._known(), key_id)
        if found is None and self._is_failing:  # it may be a new key that could not be fetched
            raise KeysUnavailable(self._source.place)
        return found

    def tells(self, key: Key) -> bool:
        return is_told(self._known(), key)

    def _known(self) -> KeysById:
        """Raises KeysUnavailable if there are no keys, or they are too old."""
        if self._keys is None or self._are_too_old:
            raise KeysUnavailable(self._source.place)
        return self._keys

    @property
    def _age_s(self) -> float:
        return self._clock() - self._fetched_at

    @property
    def _are_too_old(self) -> bool:
        return self._age_s > self._source.refresh_s + self._source.stale_s

    def wanted(self, key_id: str) -> Future[None] | None:
        with self._lock:
            is_known = find_key(self._keys or {}, key_id) is not None
            if not self._is_due() and is_known:
                return None
            under_way = self._ask()
            if under_way is None or self._num_waiting >= MOST_WAITING or (is_known and self._is_good_enough()):
                return None
            self._num_waiting += 1
            return under_way

    def look(self) -> None:
        with self._lock:
            if self._is_due():
                self._ask()

    def _is_due(self) -> bool:
        return self._keys is None or self._age_s > self._source.refresh_s

    def _is_good_enough(self) -> bool:
        """Whether a known key may be used without waiting for the fetch in progress.

        It may if the fetch began as soon as it was due, or if the issuer does not answer. Otherwise nobody has called
        for a long time, and the key may have been revoked meanwhile.
        """
        is_asked_for = self._is_failing or self._age_s <= self._source.refresh_s + GIVE_UP_S
        return is_asked_for and not self._are_too_old

    def _ask(self) -> Future[None] | None:
        """The fetch in progress, or a new one; None if it is too early for one (`RETRY_S`)."""
        now = self._clock()
        if self._under_way is not None:
            if self._tried_at is None or now - self._tried_at < GIVE_UP_S:
                return self._under_way
            self._end(self._under_way, None, TimeoutError(f"no answer within {GIVE_UP_S:g} s"))
        is_once_more = self._is_failing or not self._is_due()  # `refresh_s` may be shorter than RETRY_S
        if self._tried_at is not None and is_once_more and now - self._tried_at < RETRY_S:
            return None
        self._tried_at, self._num_waiting = now, 0
        under_way = self._under_way = Future[None]()
        try:
            self._begin(lambda: self._renew(under_way))
        except Exception as error:  # no thread can be started
            self._end(under_way, None, error)
        return under_way

    def _renew(self, under_way: Future[None]) -> None:
        keys: KeysById | None = None
        failure: Exception | None = None
        try:
            keys = self._fetch()
        except Exception as error:  # whatever it is: later fetches must be possible, and the old keys stay valid
            failure = error
        with self._lock:
            self._end(under_way, keys, failure)

    def _end(self, under_way: Future[None], keys: KeysById | None, failure: Exception | None) -> None:
        """Record the result of a fetch, unless it was given up before."""
        if self._under_way is not under_way:
            return
        self._under_way = None
        if keys is None:
            if not self._is_failing:
                _log.error("keys of %s cannot be fetched, the last ones stay valid for a while: %s",
                           self._source.place, _in_words(failure))  # fmt: skip
            self._is_failing = True
        else:
            if self._is_failing or self._keys is None or keys.keys() != self._keys.keys():
                _log.info("keys of %s: %s", self._source.place, ", ".join(sorted(keys)) or "none")
            self._keys, self._fetched_at, self._is_failing = keys, self._clock(), False
        under_way.set_result(None)


def _in_words(failure: Exception | None) -> str:
    return str(failure) if isinstance(failure, OSError | ValueError) else repr(failure)


class KeyRings:
    """The keys of all issuers, kept when the tenants' file is read again."""

    def __init__(self, begin: Callable[[Callable[[], None]], None] = in_thread) -> None:
        self._begin = begin
        self._keys: dict[KeySource, Keys] = {}

    def of(self, source: KeySource) -> Keys:
        """The keys of a source. Raises ValueError or OSError if a file that it names cannot be read."""
        found = self._keys.get(source)
        if found is None:
            if source.authority:
                check_authorities(source.authority)
            found = FetchedKeys(source, begin=self._begin) if source.is_url else FileKeys(source.place)
            self._keys[source] = found
        return found
