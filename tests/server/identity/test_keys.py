"""Keys of issuers: how they are fetched, kept and refreshed, and what happens while the issuer is down."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import NoReturn

import pytest

from motiongen_server.identity.issuers import KeySource
from motiongen_server.identity.key_set import keys_of
from motiongen_server.identity.keys import GIVE_UP_S, MOST_WAITING, RETRY_S, FetchedKeys, KeyRings, KeysUnavailable
from motiongen_server.identity.tokens import new_token
from tests.server.identity.files import TenantsFile, bearer
from tests.server.identity.issuer import Issuer

ODD_KEY = {"kty": "RSA", "kid": "a", "n": "AQAB", "e": "AQAB", "alg": ["RS256"]}


class Clock:
    """Fetched keys on a clock that the test moves, with fetches that run when the test calls `work`."""

    def __init__(self, issuer: Issuer) -> None:
        self.now = 1000.0
        self.waiting: list[Callable[[], None]] = []
        self.issuer = issuer
        source = KeySource("https://login.example/jwks", refresh_s=300, stale_s=3600)
        self.keys = FetchedKeys(source, self.fetch, lambda: self.now, self.waiting.append)

    def fetch(self) -> dict[str, object]:  # type: ignore[override]
        self.issuer.asked += 1
        if self.issuer.is_down:
            raise ConnectionRefusedError("down")
        return keys_of(self.issuer.document())  # type: ignore[return-value]

    def work(self) -> None:
        """Run the fetches that were begun."""
        while self.waiting:
            self.waiting.pop()()

    def knows(self, name: str) -> bool:
        return self.keys.find(name) is not None


@pytest.fixture
def clock() -> Clock:
    return Clock(Issuer(first="ES256", second="ES256"))


def test_first_callers_share_one_fetch_and_its_keys_are_kept(clock: Clock) -> None:
    with pytest.raises(KeysUnavailable):
        clock.keys.find("first")
    waiting = clock.keys.wanted("first")
    assert isinstance(waiting, Future)
    assert clock.keys.wanted("second") is waiting
    assert not waiting.done()
    clock.work()
    assert waiting.done()
    assert clock.knows("first")
    assert clock.keys.wanted("first") is None
    assert clock.issuer.asked == 1


def test_keys_are_refreshed_once_their_refresh_time_has_passed(clock: Clock) -> None:
    clock.keys.look()
    clock.work()
    clock.now += 299
    clock.keys.look()
    assert clock.waiting == []
    clock.now += 2
    del clock.issuer.keys["first"]
    clock.keys.look()
    clock.work()
    assert (clock.knows("first"), clock.knows("second"), clock.issuer.asked) == (False, True, 2)


def test_token_with_a_known_key_does_not_wait_for_a_slow_issuer(clock: Clock) -> None:
    clock.keys.look()
    clock.work()
    clock.now += 301
    clock.keys.look()
    assert len(clock.waiting) == 1, "a fetch is running"
    assert clock.keys.wanted("first") is None
    assert isinstance(clock.keys.wanted("third"), Future)
    clock.issuer.is_down = True
    for _ in range(10):
        clock.now += RETRY_S
        clock.work()
        assert (clock.keys.wanted("first"), len(clock.waiting)) == (None, 1), "fetches go on in the background"
    clock.now += 3600
    assert isinstance(clock.keys.wanted("first"), Future), "keys this old are no longer used"


def test_keys_with_a_refresh_time_of_a_second_are_fetched_every_second(clock: Clock) -> None:
    source = KeySource("https://login.example/jwks", refresh_s=1, stale_s=0)
    keys = FetchedKeys(source, clock.fetch, lambda: clock.now, clock.waiting.append)  # type: ignore[arg-type]
    for _ in range(5):
        keys.look()
        clock.work()
        assert keys.find("first") is not None
        clock.now += 1.1
    clock.issuer.is_down = True
    keys.look()
    clock.work()
    clock.now += 1.1
    keys.look()
    assert clock.waiting == [], "an issuer that is down is asked less often"


def test_keys_not_refreshed_for_long_are_fetched_before_they_are_used(clock: Clock) -> None:
    clock.keys.look()
    clock.work()
    clock.now += 300 + GIVE_UP_S + 1
    assert isinstance(clock.keys.wanted("first"), Future)
    del clock.issuer.keys["first"]
    clock.work()
    assert not clock.knows("first")


def test_unknown_keys_trigger_a_fetch_but_not_often(clock: Clock) -> None:
    clock.keys.look()
    clock.work()
    clock.now += RETRY_S
    clock.issuer.keys["third"] = "ES256"
    assert clock.keys.wanted("third") is not None
    clock.work()
    assert clock.knows("third")
    for number in range(50):
        assert clock.keys.wanted(f"made up {number}") is None
    assert (clock.waiting, clock.issuer.asked) == ([], 2)


def test_number_of_waiting_callers_is_bounded(clock: Clock) -> None:
    waiting = [clock.keys.wanted("first") for _ in range(MOST_WAITING + 5)]
    assert waiting.count(None) == 5


def test_old_keys_stay_valid_for_a_while_when_they_cannot_be_refreshed(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    clock.keys.look()
    clock.work()
    clock.issuer.is_down = True
    for _ in range(12):
        clock.now += 300
        clock.keys.look()
        clock.work()
        assert clock.knows("first")
    assert len([line for line in caplog.messages if "cannot be fetched" in line]) == 1, "an outage is logged once"
    clock.now += 301
    with pytest.raises(KeysUnavailable):
        clock.keys.find("first")
    clock.issuer.is_down = False
    clock.keys.look()
    clock.work()
    assert clock.knows("first")
    assert caplog.messages[-1].endswith("first, second")


def test_callers_do_not_wait_again_right_after_a_failed_fetch(clock: Clock) -> None:
    clock.issuer.is_down = True
    assert clock.keys.wanted("first") is not None
    clock.work()
    assert clock.keys.wanted("first") is None
    clock.now += RETRY_S
    assert clock.keys.wanted("first") is not None


def test_token_without_a_key_name_uses_the_only_key() -> None:
    clock = Clock(Issuer(first="ES256"))
    clock.keys.look()
    clock.work()
    assert clock.knows("")
    clock.issuer.keys["second"] = "ES256"
    clock.now += 400
    clock.keys.look()
    clock.work()
    assert not clock.knows("")


def test_encryption_keys_and_shared_secrets_are_skipped() -> None:
    document = Issuer(good="ES256").document()
    (good,) = document["keys"]
    shared = {"kty": "oct", "k": "c2VjcmV0", "kid": "shared"}
    document["keys"] += [{**good, "kid": "b", "use": "enc"}, shared, {"kty": "new kind", "kid": "c"}, 7]
    assert list(keys_of(document)) == ["good"]


@pytest.mark.parametrize("document", [[], {}, {"keys": {}}, None])
def test_document_that_is_not_a_key_set_is_refused(document: object) -> None:
    with pytest.raises(ValueError, match="not a set of keys"):
        keys_of(document)


def test_missing_authority_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        KeyRings().of(KeySource("https://login.example/jwks", authority=str(tmp_path / "nowhere")))


def test_missing_or_invalid_key_file_is_refused_and_a_valid_one_is_shared(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    with pytest.raises(OSError, match="No such file"):
        KeyRings().of(KeySource(str(path)))
    path.write_text("{")
    with pytest.raises(ValueError, match="Expecting"):
        KeyRings().of(KeySource(str(path)))
    path.write_text(json.dumps(Issuer().document()))
    rings = KeyRings()
    assert rings.of(KeySource(str(path))).find("first") is not None
    assert rings.of(KeySource(str(path))) is rings.of(KeySource(str(path)))


def test_malformed_keys_are_skipped_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    document = Issuer(good="ES256").document()
    odd = [{"kty": ["RSA"], "kid": "b"}, {"kty": "RSA", "n": 5, "e": "AQAB"}]
    document["keys"] = [ODD_KEY, *odd, *document["keys"], {"kty": "EC", "crv": [], "x": {}, "y": 1, "kid": {}}]
    assert list(keys_of(document)) == ["good"]
    told = [line.message for line in caplog.records if line.levelno >= logging.WARNING]
    assert len(told) == 1
    assert "'a'" in told[0]


def test_malformed_key_in_the_file_locks_nobody_out(
    tmp_path: Path, tenants: TenantsFile, caplog: pytest.LogCaptureFixture
) -> None:
    issuer, path = Issuer(first="ES256"), tmp_path / "keys.json"
    path.write_text(json.dumps(issuer.document()))
    tenants.wall = time.time()
    own, kept = new_token()
    more = f"tokens = [{{ hash = '{kept}' }}]"
    tenants.write(issuer.entry(str(path), tenant=f"issuers = ['corp']\n{more}"))
    callers = tenants.callers()
    for text in (json.dumps({"keys": [ODD_KEY, *issuer.document()["keys"]]}), "[" * 100_000):
        path.write_text(text)
        for _ in range(20):
            assert callers.identify(bearer(own), {}).tenant == "studio"
            assert callers.identify(bearer(issuer.token()), {}).tenant == "studio"
    assert len([line for line in caplog.records if line.levelno >= logging.WARNING]) == 2
    path.write_text("[" * 100_000)
    with pytest.raises(ValueError, match="too deep"):
        KeyRings().of(KeySource(str(path)))


def test_unexpected_error_in_a_fetch_keeps_the_keys_and_later_fetches(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    clock.keys.look()
    clock.work()
    for _ in range(3):
        clock.now += 301
        clock.issuer.keys["odd"] = "no algorithm"  # a KeyError, in the fetch
        clock.keys.look()
        clock.work()
        assert clock.knows("first")
    assert len(caplog.messages) == 1
    del clock.issuer.keys["odd"]
    clock.issuer.keys["third"] = "ES256"
    clock.now += 301
    clock.keys.look()
    clock.work()
    assert clock.knows("third")


def test_fetch_whose_thread_cannot_start_fails_and_is_retried(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_thread(_work: Callable[[], None]) -> NoReturn:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patched:
        patched.setattr(clock.keys, "_begin", no_thread)
        waiting = clock.keys.wanted("first")
        assert waiting is not None
        assert waiting.done()
    clock.now += RETRY_S
    clock.keys.look()
    clock.work()
    assert clock.knows("first")


def test_overdue_fetch_is_abandoned_and_its_late_result_ignored(clock: Clock) -> None:
    first = clock.keys.wanted("first")
    assert first is not None
    (late,) = clock.waiting
    clock.waiting.clear()
    clock.now += GIVE_UP_S - 1
    assert clock.keys.wanted("first") is first
    clock.now += 1
    assert clock.keys.wanted("first") is not first
    assert first.done()
    clock.work()
    assert clock.knows("first")
    clock.issuer.keys = {"second": "ES256"}
    late()
    assert clock.knows("first")
