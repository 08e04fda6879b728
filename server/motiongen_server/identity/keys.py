"""Keys of an issuer: read from a file, or fetched, kept, and fetched again before they are old or when one is new."""

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
"""After which a fetch has failed, whatever its thread waits for: another may be begun."""
RETRY_S = 10.0
"""Least time after a fetch that failed, or that was not due: tokens of made-up keys cannot have the issuer asked more
often."""
MOST_WAITING = 64
"""Calls that may wait for one fetch; more are decided by what is known."""


class KeysUnavailable(Exception):
    """Nothing is known of a key: none came from the issuer, or they are too old, or newer ones cannot be had."""


class Keys(Protocol):
    """An issuer's public keys at present. key_id: "" where a token names none."""

    def find(self, key_id: str) -> Key | None:
        """The key of that name; without one, the only key there is. Raises KeysUnavailable."""

    def tells(self, key: Key) -> bool:
        """Whether that is one of them. Raises KeysUnavailable."""

    def wanted(self, key_id: str) -> Future[None] | None:
        """What is worth waiting for before `find` is asked."""

    def look(self) -> None:
        """See whether they have changed, or have to be fetched."""


class FileKeys:
    """Of a file, read anew when it changes."""

    def __init__(self, path: str) -> None:
        """Raises ValueError, and OSError where it cannot be read."""
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
        raise ValueError(f"{path} is no set of keys; its lists lie in each other too deep") from error


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
        self._under_way: Future[None] | None = None  # since `_tried_at`
        self._num_waiting = 0
        self._is_failing = False

    def find(self, key_id: str) -> Key | None:
        found = find_key(self._known(), key_id)
        if found is None and self._is_failing:  # it may be a new one, of which nothing has been heard
            raise KeysUnavailable(self._source.place)
        return found

    def tells(self, key: Key) -> bool:
        return is_told(self._known(), key)

    def _known(self) -> KeysById:
        """Raises KeysUnavailable where there are none, or they are too old."""
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
        """Whether a key that is known need not wait for what is being fetched: that was begun as soon as it was due, or
        the issuer does not answer. Else nobody has asked for long, and a key may have been taken back since.
        """
        is_asked_for = self._is_failing or self._age_s <= self._source.refresh_s + GIVE_UP_S
        return is_asked_for and not self._are_too_old

    def _ask(self) -> Future[None] | None:
        """The fetch that is under way, begun now unless the last was just before."""
        now = self._clock()
        if self._under_way is not None:
            if self._tried_at is None or now - self._tried_at < GIVE_UP_S:
                return self._under_way
            self._end(self._under_way, None, TimeoutError(f"nothing came in {GIVE_UP_S:g} s"))
        is_once_more = self._is_failing or not self._is_due()  # else they may be good for less than that
        if self._tried_at is not None and is_once_more and now - self._tried_at < RETRY_S:
            return None
        self._tried_at, self._num_waiting = now, 0
        under_way = self._under_way = Future[None]()
        try:
            self._begin(lambda: self._renew(under_way))
        except Exception as error:  # there is no thread left
            self._end(under_way, None, error)
        return under_way

    def _renew(self, under_way: Future[None]) -> None:
        keys: KeysById | None = None
        failure: Exception | None = None
        try:
            keys = self._fetch()
        except Exception as error:  # whatever it is: it must not be the last fetch, and the keys that were hold
            failure = error
        with self._lock:
            self._end(under_way, keys, failure)

    def _end(self, under_way: Future[None], keys: KeysById | None, failure: Exception | None) -> None:
        """A fetch is over, unless it was given up before."""
        if self._under_way is not under_way:
            return
        self._under_way = None
        if keys is None:
            if not self._is_failing:
                _log.error("keys of %s cannot be fetched, those that were hold for a while: %s",
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
