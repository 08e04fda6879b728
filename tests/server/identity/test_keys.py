"""Keys of issuers: fetched, kept, fetched again, and what happens while they cannot be."""

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
    """Time that a test moves, and work that it does when it likes."""

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
        """Do what was begun."""
        while self.waiting:
            self.waiting.pop()()

    def knows(self, name: str) -> bool:
        return self.keys.find(name) is not None


@pytest.fixture
def clock() -> Clock:
    return Clock(Issuer(first="ES256", second="ES256"))


def test_keys_are_waited_for_once_and_then_kept(clock: Clock) -> None:
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


def test_they_are_fetched_again_before_they_are_old(clock: Clock) -> None:
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


def test_who_has_a_key_that_is_known_does_not_wait_for_an_issuer_that_does_not_answer(clock: Clock) -> None:
    clock.keys.look()
    clock.work()
    clock.now += 301
    clock.keys.look()
    assert len(clock.waiting) == 1, "they are being fetched"
    assert clock.keys.wanted("first") is None
    assert isinstance(clock.keys.wanted("third"), Future)
    clock.issuer.is_down = True
    for _ in range(10):
        clock.now += RETRY_S
        clock.work()
        assert (clock.keys.wanted("first"), len(clock.waiting)) == (None, 1), "they are asked for meanwhile"
    clock.now += 3600
    assert isinstance(clock.keys.wanted("first"), Future), "what is too old is of no use to anybody"


def test_keys_that_are_good_for_a_second_are_fetched_every_second(clock: Clock) -> None:
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
    assert clock.waiting == [], "who is down is asked less often"


def test_where_nobody_has_called_for_long_a_key_is_looked_for_before_it_lets_in(clock: Clock) -> None:
    clock.keys.look()
    clock.work()
    clock.now += 300 + GIVE_UP_S + 1
    assert isinstance(clock.keys.wanted("first"), Future)
    del clock.issuer.keys["first"]
    clock.work()
    assert not clock.knows("first")


def test_a_key_that_is_not_known_is_asked_for_but_not_often(clock: Clock) -> None:
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


def test_only_so_many_wait(clock: Clock) -> None:
    waiting = [clock.keys.wanted("first") for _ in range(MOST_WAITING + 5)]
    assert waiting.count(None) == 5


def test_while_they_cannot_be_fetched_the_old_ones_hold_for_a_while(
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
    assert len([line for line in caplog.messages if "cannot be fetched" in line]) == 1, "an outage is told once"
    clock.now += 301
    with pytest.raises(KeysUnavailable):
        clock.keys.find("first")
    clock.issuer.is_down = False
    clock.keys.look()
    clock.work()
    assert clock.knows("first")
    assert caplog.messages[-1].endswith("first, second")


def test_after_a_failed_fetch_nobody_waits_for_the_next(clock: Clock) -> None:
    clock.issuer.is_down = True
    assert clock.keys.wanted("first") is not None
    clock.work()
    assert clock.keys.wanted("first") is None
    clock.now += RETRY_S
    assert clock.keys.wanted("first") is not None


def test_without_a_name_the_only_key_is_meant() -> None:
    clock = Clock(Issuer(first="ES256"))
    clock.keys.look()
    clock.work()
    assert clock.knows("")
    clock.issuer.keys["second"] = "ES256"
    clock.now += 400
    clock.keys.look()
    clock.work()
    assert not clock.knows("")


def test_keys_to_encrypt_with_and_shared_ones_are_passed_over() -> None:
    document = Issuer(good="ES256").document()
    (good,) = document["keys"]
    shared = {"kty": "oct", "k": "c2VjcmV0", "kid": "shared"}
    document["keys"] += [{**good, "kid": "b", "use": "enc"}, shared, {"kty": "new kind", "kid": "c"}, 7]
    assert list(keys_of(document)) == ["good"]


@pytest.mark.parametrize("document", [[], {}, {"keys": {}}, None])
def test_what_is_no_set_of_keys_is_said_to_be_none(document: object) -> None:
    with pytest.raises(ValueError, match="not a set of keys"):
        keys_of(document)


def test_an_authority_must_be_there(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        KeyRings().of(KeySource("https://login.example/jwks", authority=str(tmp_path / "nowhere")))


def test_a_file_of_keys_must_be_there_and_be_one(tmp_path: Path) -> None:
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


def test_a_key_that_is_none_is_passed_over_and_told(caplog: pytest.LogCaptureFixture) -> None:
    document = Issuer(good="ES256").document()
    odd = [{"kty": ["RSA"], "kid": "b"}, {"kty": "RSA", "n": 5, "e": "AQAB"}]
    document["keys"] = [ODD_KEY, *odd, *document["keys"], {"kty": "EC", "crv": [], "x": {}, "y": 1, "kid": {}}]
    assert list(keys_of(document)) == ["good"]
    told = [line.message for line in caplog.records if line.levelno >= logging.WARNING]
    assert len(told) == 1
    assert "'a'" in told[0]


def test_a_file_that_gets_an_odd_key_lets_in_whom_it_has_let_in(
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


def test_whatever_a_fetch_raises_the_next_is_begun_and_the_keys_that_were_hold(
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


def test_without_a_thread_a_fetch_has_failed_and_is_tried_again(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_fetch_that_does_not_end_is_given_up_and_what_it_brings_then_is_nothing(clock: Clock) -> None:
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
