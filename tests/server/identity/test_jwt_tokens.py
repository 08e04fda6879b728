"""Tokens that an issuer has signed: which are accepted, and why others are refused."""

from __future__ import annotations

import base64
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import jwt
import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.identity import issuers as entries
from motiongen_server.identity.callers import Callers
from motiongen_server.identity.issuers import KeySource
from motiongen_server.identity.jwt_tokens import Checked, TokenChecks, Unchecked, checked, unchecked
from motiongen_server.identity.keys import KeyRings, Keys
from tests.server.identity.files import TenantsFile, bearer
from tests.server.identity.issuer import LIFE_S, NAME, Issuer, public_pem


@pytest.fixture
def issuer() -> Issuer:
    return Issuer(first="ES256", second="RS256", third="EdDSA", fourth="PS256")


@pytest.fixture
def callers(issuer: Issuer, tenants: TenantsFile, tmp_path: Path) -> Callers:
    (tmp_path / "keys.json").write_text(json.dumps(issuer.document()))
    tenants.wall = time.time()
    tenants.write(issuer.entry(str(tmp_path / "keys.json"), "leeway_s = 20"))
    return tenants.callers()


def refusal(callers: Callers, token: str) -> StreamRefused:
    with pytest.raises(StreamRefused) as refused:
        callers.identify(bearer(token), {})
    return refused.value


@pytest.mark.parametrize(("key", "algorithm"), [("first", "ES256"), ("second", "RS256"), ("third", "EdDSA")])
def test_signed_token_identifies_its_tenant(issuer: Issuer, callers: Callers, key: str, algorithm: str) -> None:
    now = int(time.time())
    token = issuer.token(key, algorithm, exp=now + LIFE_S)
    caller = callers.identify(bearer(token), {})
    assert (caller.tenant, caller.expires_at) == ("studio", now + LIFE_S + 20)
    assert callers.lapse(caller) is None
    assert token not in repr(caller)


def test_algorithm_that_is_not_allowed_is_refused(issuer: Issuer, callers: Callers) -> None:
    assert refusal(callers, issuer.token("fourth", "PS256")).reason == "CREDENTIALS_INVALID"


def unsigned(algorithm: str, key: str = "first") -> str:
    parts = ({"alg": algorithm, "kid": key}, {"iss": NAME, "aud": "motiongen", "exp": 9e9, "tenant": "studio"})
    return ".".join(base64.urlsafe_b64encode(json.dumps(part).encode()).decode().rstrip("=") for part in parts) + "."


@pytest.mark.parametrize(
    ("key", "algorithm"),
    [("second", "RS256"), ("second", "RS512"), ("fourth", "PS256"), ("first", "ES256"), ("third", "EdDSA")],
)
def test_key_without_an_algorithm_accepts_only_allowed_ones_of_its_kind(
    issuer: Issuer, tenants: TenantsFile, tmp_path: Path, key: str, algorithm: str
) -> None:
    document = issuer.document()
    for told in document["keys"]:
        del told["alg"]
    (tmp_path / "keys.json").write_text(json.dumps(document))
    entry = issuer.entry(str(tmp_path / "keys.json"))
    tenants.wall = time.time()
    tenants.write(entry.replace("'RS256'", "'RS256', 'RS512', 'PS256'"))
    token = issuer.token(key, algorithm)
    assert tenants.callers().identify(bearer(token), {}).tenant == "studio"
    for forged in (unsigned(name, key) for name in ("none", "HS256", algorithm)):
        assert refusal(tenants.callers(), forged).reason == "CREDENTIALS_INVALID"
    head = base64.urlsafe_b64encode(json.dumps({"alg": "RS256" if key == "first" else "ES256", "kid": key}).encode())
    other = f"{head.decode().rstrip('=')}.{token.partition('.')[2]}"
    assert refusal(tenants.callers(), other).reason == "CREDENTIALS_INVALID", "an algorithm of another kind of key"
    tenants.write(entry.replace(f"'{algorithm}'", "'ES384'"))
    if algorithm != "RS512":
        assert refusal(tenants.callers(), token).reason == "CREDENTIALS_INVALID", "this issuer no longer allows it"


@pytest.mark.parametrize("algorithm", ["none", "None", "HS256", "ES256"])
def test_token_without_a_signature_is_refused(callers: Callers, algorithm: str) -> None:
    assert refusal(callers, unsigned(algorithm)).reason == "CREDENTIALS_INVALID"


def test_token_signed_with_the_public_key_as_a_secret_is_refused(callers: Callers) -> None:
    claims = {"iss": NAME, "aud": "motiongen", "exp": int(time.time()) + LIFE_S, "tenant": "studio"}
    secret = base64.urlsafe_b64encode(public_pem("RS256", "second")).decode()  # PyJWT refuses to sign with a PEM
    forged = jwt.encode(claims, secret, "HS256", {"kid": "second"})
    assert refusal(callers, forged).reason == "CREDENTIALS_INVALID"


def test_wrong_key_changed_payload_and_unknown_issuer_are_refused(issuer: Issuer, callers: Callers) -> None:
    assert refusal(callers, Issuer().token("stranger")).reason == "CREDENTIALS_INVALID"
    head, _, signature = issuer.token().split(".")
    other = issuer.token(tenant="other").split(".")[1]
    assert refusal(callers, f"{head}.{other}.{signature}").reason == "CREDENTIALS_INVALID"
    assert refusal(callers, issuer.token(iss="https://elsewhere.example")).reason == "CREDENTIALS_INVALID"


@pytest.mark.parametrize("claim", ["exp", "aud", "iss", "tenant"])
def test_token_without_a_required_claim_is_refused(issuer: Issuer, callers: Callers, claim: str) -> None:
    assert refusal(callers, issuer.token(**{claim: None})).reason == "CREDENTIALS_INVALID"


def test_refusal_of_a_genuine_token_names_the_wrong_claim(issuer: Issuer, callers: Callers) -> None:
    assert "audience is motiongen" in str(refusal(callers, issuer.token(aud=["billing"])))
    assert "no claim 'tenant'" in str(refusal(callers, issuer.token(tenant=7)))
    assert "the tenant 'other'" in str(refusal(callers, issuer.token(tenant="other")))


def test_clocks_may_differ_by_the_leeway_and_no_more(issuer: Issuer, callers: Callers) -> None:
    now = int(time.time())
    assert callers.identify(bearer(issuer.token(exp=now - 5)), {}).tenant == "studio"
    assert callers.identify(bearer(issuer.token(iat=now + 15, nbf=now + 15)), {}).tenant == "studio"
    assert refusal(callers, issuer.token(exp=now - 60)).reason == "CREDENTIALS_EXPIRED"
    for claim in ("nbf", "iat"):
        early = refusal(callers, issuer.token(**{claim: now + LIFE_S}))
        assert (early.reason, "set the clocks" in str(early), "20 s" in str(early)) == (
            "CREDENTIALS_INVALID",
            True,
            True,
        )
    assert refusal(callers, issuer.token(exp=10**400)).reason == "CREDENTIALS_INVALID"


def test_signed_token_expires_after_the_leeway(issuer: Issuer, tenants: TenantsFile, callers: Callers) -> None:
    caller = callers.identify(bearer(issuer.token(exp=int(tenants.wall) + 100)), {})
    tenants.wall += 119
    assert callers.lapse(caller) is None
    assert 0 < (callers.remaining_s(caller) or 0) < 2
    tenants.wall += 2
    lapse = callers.lapse(caller)
    assert lapse is not None
    assert lapse.reason == "CREDENTIALS_EXPIRED"


def test_issuer_may_name_only_tenants_that_list_it(
    issuer: Issuer, tenants: TenantsFile, callers: Callers, tmp_path: Path
) -> None:
    caller = callers.identify(bearer(issuer.token()), {})
    tenants.write(issuer.entry(str(tmp_path / "keys.json"), tenant="roles = ['motion', 'admin']"))
    assert refusal(callers, issuer.token()).reason == "CREDENTIALS_INVALID"
    lapse = callers.lapse(caller)
    assert lapse is not None
    assert lapse.reason == "CREDENTIALS_REVOKED"


def test_removed_key_revokes_callers_admitted_with_it(issuer: Issuer, callers: Callers, tmp_path: Path) -> None:
    caller = callers.identify(bearer(issuer.token()), {})
    del issuer.keys["first"]
    (tmp_path / "keys.json").write_text(json.dumps(issuer.document()))
    callers.look()
    lapse = callers.lapse(caller)
    assert lapse is not None
    assert lapse.reason == "CREDENTIALS_REVOKED"
    assert refusal(callers, issuer.token()).reason == "CREDENTIALS_INVALID"


@pytest.mark.parametrize("name", ["first", ""])
def test_replaced_key_of_the_same_name_revokes_callers_of_the_old_one(
    tenants: TenantsFile, tmp_path: Path, name: str
) -> None:
    tenants.wall = time.time()

    def tell(which: str) -> None:
        told = Issuer(**{which: "ES256"}).document()
        (tmp_path / "keys.json").write_text(json.dumps({"keys": [{**told["keys"][0], "kid": name}]}))

    tell("old")
    tenants.write(Issuer().entry(str(tmp_path / "keys.json")))
    callers = tenants.callers()
    token = Issuer(old="ES256").token("old", kid=name)
    caller = callers.identify(bearer(token), {})
    assert callers.lapse(caller) is None
    tell("new")
    callers.look()
    lapse = callers.lapse(caller)
    assert lapse is not None
    assert lapse.reason == "CREDENTIALS_REVOKED"
    assert refusal(callers, token).reason == "CREDENTIALS_INVALID"


def test_reworded_key_or_one_added_beside_it_revokes_nobody(issuer: Issuer, callers: Callers, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text(json.dumps({"keys": [{**Issuer().document()["keys"][0], "kid": ""}]}))
    callers.look()
    without_name, named = callers.identify(bearer(issuer.token(kid="")), {}), Issuer().document()["keys"][0]
    for keys in ([{**named, "x5t": "more"}], [named, *Issuer(new="ES256").document()["keys"]]):
        (tmp_path / "keys.json").write_text(json.dumps({"keys": keys}))
        callers.look()
        assert callers.lapse(without_name) is None


def refuse_to_read(_token: str) -> NoReturn:
    raise AssertionError("a token that was checked before is parsed again")


def test_token_is_checked_once_until_its_key_changes(
    issuer: Issuer, callers: Callers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = []

    def noted(said: Unchecked, by: entries.Issuer, keys: Keys) -> Checked:
        checks.append(said.token)
        return checked(said, by, keys)

    monkeypatch.setattr("motiongen_server.identity.jwt_tokens.checked", noted)
    token = issuer.token()
    assert callers.num_unchecked(bearer(token)) == len(token)
    for _ in range(5):
        assert callers.identify(bearer(token), {}).tenant == "studio"
    assert (len(checks), callers.num_unchecked(bearer(token)), callers.num_unchecked(bearer("mg_1"))) == (1, 0, 0)
    monkeypatch.setattr("motiongen_server.identity.callers.unchecked", refuse_to_read)
    (tmp_path / "keys.json").write_text(json.dumps(issuer.document(), indent=1))  # the same keys once more
    callers.look()
    assert callers.num_unchecked(bearer(token)) == 0
    assert callers.identify(bearer(token), {}).tenant == "studio"
    assert len(checks) == 1
    changed = issuer.document()
    changed["keys"][0] = {**Issuer(other="ES256").document()["keys"][0], "kid": "first"}
    (tmp_path / "keys.json").write_text(json.dumps(changed))
    callers.look()
    assert callers.num_unchecked(bearer(token)) == len(token)
    assert refusal(callers, token).reason == "CREDENTIALS_INVALID"


def test_remembered_checks_are_bounded_and_depend_on_the_issuers_settings(issuer: Issuer, tmp_path: Path) -> None:
    (tmp_path / "keys.json").write_text(json.dumps(issuer.document()))
    keys = KeyRings().of(KeySource(str(tmp_path / "keys.json")))
    of = entries.Issuer("corp", NAME, ("motiongen",), KeySource(str(tmp_path / "keys.json")))
    checks = TokenChecks(most=2)
    said = [unchecked(issuer.token(exp=int(time.time()) + LIFE_S + number)) for number in range(3)]
    for each in said:
        assert each is not None
        checks.check(each, of, keys)
    assert [checks.known(each, of, keys) is not None for each in said if each is not None] == [False, True, True]
    assert said[2] is not None
    assert checks.known(said[2], replace(of, leeway_s=1.0), keys) is None, "the issuer's settings have changed"


@pytest.mark.parametrize("junk", ["a.b.c", "..", "." * 2 + "x" * 9000, "mg_1.2.3", "é.é.é", "e30.e30.e30"])
def test_malformed_tokens_are_refused(callers: Callers, junk: str) -> None:
    assert refusal(callers, junk).reason == "CREDENTIALS_INVALID"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("audience = []", "audience is empty"),
        ("algorithms = ['HS256']", "algorithms has HS256; known are RS256"),
        ("algorithms = ['none']", "algorithms has none"),
        ("algorithms = []", "algorithms has none"),
        ("issuer = 'corp'", "has no keys, and its issuer is not a URL"),
        ("keys = 'http://login.example/jwks'", "keys are fetched only by https"),
        ("keys = 'ftp://127.0.0.1/jwks'", "keys are fetched only by https"),
        ("keys = 'https://me:hush@login.example/jwks'", "has a name or a password in its URL"),
        ("leeway_s = 1000", "leeway_s is 1000"),
        ("colour = 'red'", "issuers.corp has colour; known are algorithms"),
        ("issuer = ''", "issuer must be a non-empty string"),
    ],
)
def test_invalid_issuer_settings_raise_errors_that_say_why(tenants: TenantsFile, change: str, said: str) -> None:
    name = change.split()[0]
    lines = {"issuer": "issuer = 'https://a'", "audience": "audience = ['b']", name: change}
    tenants.write("[issuers.corp]\n" + "\n".join(lines.values()))
    with pytest.raises(ValueError, match=said):
        tenants.callers()


def test_tenant_with_an_unknown_issuer_is_refused(tenants: TenantsFile) -> None:
    tenants.write("[tenants.a]\nissuers = ['corp']")
    with pytest.raises(ValueError, match="issuers has corp; known are none"):
        tenants.callers()
