"""The file of tenants: its settings, and the errors for invalid ones."""

from __future__ import annotations

import pytest

from motiongen_server.identity.caller import Role
from motiongen_server.identity.tenants import QUOTAS, read_tenants
from motiongen_server.identity.tokens import new_token
from motiongen_server.rpc.limits import PeerLimits
from tests.server.identity.files import TenantsFile

HASH = str(new_token()[1])


def test_every_setting_of_the_file_is_read(tenants: TenantsFile) -> None:
    tenants.write(f"""
        [tenants.studio]
        roles = ["motion", "metrics"]
        certificates = ["studio.example"]
        tokens = [{{ hash = "{HASH}", expires = 2027-01-15T08:00:00Z }}]
        quota = {{ heroes = 8, events_per_second = 100.5 }}
        [tenants.operator]
        roles = ["admin"]
    """)
    read = read_tenants(str(tenants.path))
    studio = read.by_certificate["studio.example"]
    assert (studio.name, studio.roles) == ("studio", {Role.MOTION, Role.METRICS})
    assert studio.quota == {"heroes": 8, "events_per_second": 100.5}
    assert [token.expires_at for token in studio.tokens] == [1_800_000_000.0]
    assert read.by_name["operator"].roles == {Role.ADMIN}


def test_every_quota_is_a_limit_of_addresses_too() -> None:
    assert set(QUOTAS) <= set(PeerLimits.__dataclass_fields__)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[tenants", "tenants.toml: "),
        ("[tenant.studio]", "the file has tenant; known are issuers, tenants"),
        ("[tenants.studio]\nrole = []", "studio has role; known are certificates, issuers, quota, roles, tokens"),
        ("[tenants.studio]\nroles = ['root']", "studio.roles has root; known are motion, admin, metrics"),
        ("[tenants.studio]\nroles = 'motion'", "studio.roles must be a list of non-empty strings"),
        ("[tenants.studio]\ntokens = ['mg_1_2']", "studio.tokens must be a table"),
        ("[tenants.studio]\ntokens = 'mg_1_2'", "studio.tokens must be a list"),
        ("[tenants.'']", "an entry without a name"),
        ("[tenants.studio]\ntokens = [{ hash = 'mg_1_2' }]", "a token's hash is not one that"),
        (f"[tenants.studio]\ntokens = [{{ hash = '{HASH}', expires = 2027-01-15 }}]", "give date, time and zone"),
        ("[tenants.studio]\nquota = { heroes = -1 }", "studio.quota.heroes is -1; it must be a number from 0"),
        ("[tenants.studio]\nquota = { heroes = true }", "studio.quota.heroes is True"),
        ("[tenants.studio]\nquota = { elves = 1 }", "studio.quota has elves; known are"),
        (f"[tenants.a]\ntokens = [{{hash='{HASH}'}}]\n[tenants.b]\ntokens = [{{hash='{HASH}'}}]", "is given twice"),
        ("[tenants.a]\ncertificates = ['x']\n[tenants.b]\ncertificates = ['x']", "certificate 'x' is given twice"),
    ],
)
def test_invalid_file_raises_an_error_that_says_why(tenants: TenantsFile, text: str, said: str) -> None:
    tenants.write(text)
    with pytest.raises(ValueError, match=said):
        read_tenants(str(tenants.path))


@pytest.mark.parametrize(
    "entry", ["tokens = ['TOKEN']", "tokens = 'TOKEN'", "tokens = [{ hash = 'TOKEN' }]", "quota = 'TOKEN'"]
)
def test_error_about_a_token_in_place_of_its_hash_does_not_show_it(tenants: TenantsFile, entry: str) -> None:
    token, _ = new_token()
    tenants.write("[tenants.studio]\n" + entry.replace("TOKEN", token))
    with pytest.raises(ValueError, match="studio") as refused:
        read_tenants(str(tenants.path))
    assert token not in str(refused.value)
