"""Identifying callers by their tokens and certificates, and when a caller's credentials lapse."""

from __future__ import annotations

import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import ANYBODY, Caller, Role
from motiongen_server.identity.callers import Callers
from motiongen_server.identity.tokens import new_token
from tests.server.identity.files import TenantsFile, bearer

CERTIFICATE = {"x509_common_name": [b"studio"], "x509_subject_alternative_name": [b"studio.example"]}
EXPIRES, EXPIRES_AT = "2027-01-15T08:00:10Z", 1_800_000_010.0


def reason_of(callers: Callers, *metadata: tuple[str, str], role: Role = Role.MOTION, **connection: list[bytes]) -> str:
    with pytest.raises(StreamRefused) as refused:
        callers.identify(metadata, connection, role)
    return refused.value.reason


def lapse_of(callers: Callers, caller: Caller) -> str | None:
    callers.look()
    lapse = callers.lapse(caller)
    return None if lapse is None else lapse.reason


def test_without_tenants_every_caller_is_admitted() -> None:
    assert Callers().identify((), {}) is ANYBODY
    assert Callers().identify((), {}, Role.ADMIN) is ANYBODY
    assert Callers().identify((), CERTIFICATE).credential == "certificate 'studio'"


def test_token_identifies_its_tenant(tenants: TenantsFile) -> None:
    token = tenants.one("quota = { heroes = 1 }", EXPIRES)
    caller = tenants.callers().identify(bearer(token), {})
    assert (caller.tenant, caller.quota, caller.expires_at) == ("studio", {"heroes": 1}, EXPIRES_AT)
    assert token not in repr(caller)
    assert token.rpartition("_")[2] not in repr(caller)


def test_certificate_identifies_its_tenant_by_any_of_its_names(tenants: TenantsFile) -> None:
    tenants.write("[tenants.a]\ncertificates = ['studio.example']")
    assert tenants.callers().identify((), CERTIFICATE).tenant == "a"


def test_invalid_token_is_refused_despite_a_valid_certificate(tenants: TenantsFile) -> None:
    tenants.write("[tenants.a]\ncertificates = ['studio.example']")
    assert reason_of(tenants.callers(), *bearer(new_token()[0]), **CERTIFICATE) == "CREDENTIALS_INVALID"


def test_missing_and_unknown_credentials_are_refused(tenants: TenantsFile) -> None:
    token = tenants.one()
    callers = tenants.callers()
    assert reason_of(callers) == "CREDENTIALS_MISSING"
    assert reason_of(callers, ("authorization", f"Basic {token}")) == "CREDENTIALS_MISSING"
    assert reason_of(callers, ("authorization", "Bearer ")) == "CREDENTIALS_INVALID"
    assert reason_of(callers, *bearer(new_token()[0])) == "CREDENTIALS_INVALID"
    assert reason_of(callers, *bearer(token[:-4] + "0000")) == "CREDENTIALS_INVALID"
    assert reason_of(callers, **CERTIFICATE) == "CREDENTIALS_INVALID"


def test_call_with_two_tokens_is_refused(tenants: TenantsFile) -> None:
    token = tenants.one()
    assert reason_of(tenants.callers(), *bearer(token), *bearer(token)) == "CREDENTIALS_INVALID"
    assert reason_of(tenants.callers(), *bearer(token), ("Authorization", "Basic x")) == "CREDENTIALS_INVALID"
    assert Callers().identify((*bearer(token), *bearer(token)), {}) is ANYBODY


def test_a_role_that_a_tenant_lacks_is_refused(tenants: TenantsFile) -> None:
    token = tenants.one("roles = ['metrics']")
    callers = tenants.callers()
    assert callers.of_header(f"Bearer {token}", Role.METRICS).tenant == "studio"
    for role in (Role.MOTION, Role.ADMIN):
        assert reason_of(callers, *bearer(token), role=role) == "ROLE_MISSING"


def test_metrics_need_a_token_with_their_role_except_on_a_loopback_address(tenants: TenantsFile) -> None:
    token = tenants.one("roles = ['metrics']")
    callers = tenants.callers()
    assert callers.metrics_refusal("127.0.0.1", "") is None
    assert callers.metrics_refusal("0.0.0.0", f"Bearer {token}") is None
    assert "authorization" in (callers.metrics_refusal("0.0.0.0", "") or "")
    assert callers.metrics_refusal("0.0.0.0", f"Bearer {new_token()[0]}") is not None
    another = tenants.one("roles = ['motion']")
    assert "the role 'metrics'" in (callers.metrics_refusal("0.0.0.0", f"Bearer {another}") or "")


def test_expired_token_lapses_and_is_refused(tenants: TenantsFile) -> None:
    token = tenants.one(expires=EXPIRES)
    callers = tenants.callers()
    caller = callers.identify(bearer(token), {})
    assert (callers.remaining_s(caller), callers.lapse(caller)) == (10.0, None)
    tenants.wall = EXPIRES_AT
    assert lapse_of(callers, caller) == "CREDENTIALS_EXPIRED"
    assert reason_of(callers, *bearer(token)) == "CREDENTIALS_EXPIRED"


def test_token_removed_from_the_file_is_revoked(tenants: TenantsFile) -> None:
    token = tenants.one()
    callers = tenants.callers()
    caller = callers.identify(bearer(token), {})
    assert lapse_of(callers, caller) is None
    another = tenants.one()
    assert lapse_of(callers, caller) == "CREDENTIALS_REVOKED"
    assert reason_of(callers, *bearer(token)) == "CREDENTIALS_INVALID"
    assert callers.identify(bearer(another), {}).tenant == "studio"


@pytest.mark.parametrize("then", ["", "[tenants.a]\nroles = ['metrics']\ncertificates = ['studio']", "[tenants.a]"])
def test_certificate_whose_access_is_removed_from_the_file_is_revoked(tenants: TenantsFile, then: str) -> None:
    tenants.write("[tenants.a]\ncertificates = ['studio']")
    callers = tenants.callers()
    caller = callers.identify((), CERTIFICATE)
    assert lapse_of(callers, caller) is None
    tenants.write(then)
    assert lapse_of(callers, caller) == "CREDENTIALS_REVOKED"


def test_unreadable_file_keeps_the_last_tenants_and_is_logged_once(
    tenants: TenantsFile, caplog: pytest.LogCaptureFixture
) -> None:
    token = tenants.one()
    callers = tenants.callers()
    caller = callers.identify(bearer(token), {})
    tenants.write("[tenants")
    for _ in range(3):
        assert lapse_of(callers, caller) is None
    tenants.path.unlink()
    for _ in range(3):
        assert lapse_of(callers, caller) is None
    assert [line.partition(" the last")[0] for line in caplog.messages] == ["tenants: cannot be read again,"] * 2
    tenants.write("")
    assert lapse_of(callers, caller) == "CREDENTIALS_REVOKED"


def test_half_written_file_revokes_nobody(tenants: TenantsFile) -> None:
    token = tenants.one()
    callers = tenants.callers()
    caller = callers.identify(bearer(token), {})
    text = tenants.path.read_text()
    for begun in ("", "\n", text[: len(text) // 2]):
        tenants.path.write_text(begun)
        assert lapse_of(callers, caller) is None
    tenants.write("[tenants]")
    assert lapse_of(callers, caller) == "CREDENTIALS_REVOKED"


def test_changed_expiry_applies_to_identified_callers(tenants: TenantsFile) -> None:
    token, kept = new_token()
    entry = f'[tenants.studio]\ntokens = [{{ hash = "{kept}"%s }}]'
    tenants.write(entry % "")
    callers = tenants.callers()
    caller = callers.identify(bearer(token), {})
    assert callers.remaining_s(caller) is None
    tenants.write(entry % f", expires = {EXPIRES}")
    assert lapse_of(callers, caller) is None
    assert callers.remaining_s(caller) == 10.0
    tenants.wall = EXPIRES_AT
    assert lapse_of(callers, caller) == "CREDENTIALS_EXPIRED"
    tenants.write(entry % "")
    assert lapse_of(callers, caller) is None


def test_losing_an_unused_role_does_not_revoke_a_caller(tenants: TenantsFile) -> None:
    tenants.write("[tenants.a]\nroles = ['motion', 'metrics']\ncertificates = ['studio']")
    callers = tenants.callers()
    caller = callers.identify((), CERTIFICATE)
    tenants.write("[tenants.a]\nroles = ['motion']\ncertificates = ['studio']")
    assert lapse_of(callers, caller) is None
    tenants.write("[tenants.a]\nroles = ['metrics']\ncertificates = ['studio']")
    assert lapse_of(callers, caller) == "CREDENTIALS_REVOKED"
