"""Keys of issuers: fetched, kept, fetched again, and what happens while they cannot be."""

from __future__ import annotations

import json
import logging
import ssl
from collections.abc import Callable
from concurrent.futures import Future
from http.client import IncompleteRead
from pathlib import Path

import pytest
from jwt import PyJWKClient

from motiongen_server.identity.issuers import DISCOVERY, KeySource
from motiongen_server.identity.keys import (
    MOST_WAITING,
    RETRY_S,
    FetchedKeys,
    KeyRings,
    KeysUnavailable,
    fetched,
    keys_of,
)
from tests.server.identity.files import AUTHORITY, CERTIFICATES
from tests.server.identity.issuer import Issuer


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
    with pytest.raises(ValueError, match="no set of keys"):
        keys_of(document)


def test_they_are_fetched_from_a_real_server_also_by_discovery() -> None:
    issuer = Issuer(first="ES256")
    with issuer.served():
        assert list(fetched(KeySource(f"{issuer.url}/jwks"))) == ["first"]
        assert list(fetched(KeySource(issuer.url + DISCOVERY, is_discovery=True))) == ["first"]
        issuer.is_down = True
        with pytest.raises(ValueError, match="503"):
            fetched(KeySource(f"{issuer.url}/jwks"))
    with pytest.raises(ValueError, match="refused"):
        fetched(KeySource(f"{issuer.url}/jwks"))


def test_by_https_they_come_only_from_who_proves_itself() -> None:
    issuer = Issuer(first="ES256")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(CERTIFICATES / "server-1.pem", CERTIFICATES / "server-1.key")
    with issuer.served(context):
        assert list(fetched(KeySource(f"{issuer.url}/jwks", authority=AUTHORITY))) == ["first"]
        for authority in ("", str(CERTIFICATES / "stranger-authority.pem")):
            with pytest.raises(ValueError, match="CERTIFICATE_VERIFY_FAILED"):
                fetched(KeySource(f"{issuer.url}/jwks", authority=authority))


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


@pytest.mark.parametrize("answer", [[], "keys", IncompleteRead(b"{")])
def test_an_answer_that_is_none_is_a_fetch_that_failed(answer: object, monkeypatch: pytest.MonkeyPatch) -> None:
    def fetch_data(_client: PyJWKClient) -> object:
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(PyJWKClient, "fetch_data", fetch_data)
    for is_discovery in (False, True):
        with pytest.raises(ValueError, match=r"login\.example"):
            fetched(KeySource("https://login.example/jwks", is_discovery=is_discovery))
