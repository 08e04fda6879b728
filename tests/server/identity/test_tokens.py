"""Tokens, the hashes that the server keeps of them, and the command that creates them."""

from __future__ import annotations

import tomllib
from datetime import UTC, datetime, tzinfo

import pytest

from motiongen_server.identity import __main__ as command
from motiongen_server.identity.__main__ import main
from motiongen_server.identity.tokens import TokenHash, new_token, number_of


def test_hash_matches_its_own_token_only() -> None:
    token, kept = new_token()
    other, _ = new_token()
    assert kept.is_of(token)
    assert not kept.is_of(other)
    assert not kept.is_of(token[:-1] + ("0" if token[-1] != "0" else "1"))


def test_hash_survives_its_text_form_and_does_not_reveal_the_secret() -> None:
    token, kept = new_token()
    assert TokenHash.parse(str(kept)) == kept
    assert number_of(token) == kept.number
    assert token.rpartition("_")[2] not in str(kept)


def test_same_token_hashed_twice_has_different_salts_and_digests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("secrets.token_hex", lambda num_bytes: "5a" * num_bytes)
    (token, one), (same, two) = new_token(), new_token()
    assert token == same
    assert one.salt != two.salt
    assert one.digest != two.digest
    assert one.is_of(token)
    assert two.is_of(token)


@pytest.mark.parametrize("given", ["", "mg_12_34", "mg_" + "0" * 12 + "_" + "g" * 64, "x" * 100_000])
def test_malformed_token_has_no_number(given: str) -> None:
    assert number_of(given) is None


@pytest.mark.parametrize("given", ["", "sha256:12:34:56", "md5:" + "0" * 12 + ":" + "0" * 32 + ":" + "0" * 64])
def test_malformed_hash_is_refused(given: str) -> None:
    with pytest.raises(ValueError, match="a token's hash"):
        TokenHash.parse(given)


def test_command_prints_a_token_and_the_entry_that_admits_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["studio", "--days", "30"]) == 0
    printed = capsys.readouterr()
    (entry,) = tomllib.loads(printed.err)["tenants"]["studio"]["tokens"]
    assert TokenHash.parse(entry["hash"]).is_of(printed.out.strip())
    assert entry["expires"].tzinfo is not None


def test_a_token_expires_after_its_days_to_the_second(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Clock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:
            return datetime(2027, 2, 27, 12, 30, 59, 999_999, tz)

    monkeypatch.setattr(command, "datetime", Clock)
    main(["studio", "--days", "2"])
    (entry,) = tomllib.loads(capsys.readouterr().err)["tenants"]["studio"]["tokens"]
    assert entry["expires"] == datetime(2027, 3, 1, 12, 30, 59, tzinfo=UTC)


def test_a_token_without_days_never_expires(capsys: pytest.CaptureFixture[str]) -> None:
    main(["studio"])
    (entry,) = tomllib.loads(capsys.readouterr().err)["tenants"]["studio"]["tokens"]
    assert list(entry) == ["hash"]


@pytest.mark.parametrize("name", ["studio", 'the "best" studio', "a\\b.c", "Café 日本"])
def test_entry_is_valid_toml_for_any_tenant_name(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name]) == 0
    assert list(tomllib.loads(capsys.readouterr().err)["tenants"]) == [name]


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["studio", "--days", "999999999999"], "it must be 0, for no expiry, or at most 36500"),
        (["studio", "--days", "3000000"], "it must be 0, for no expiry, or at most 36500"),
        (["studio", "--days", "-1"], "it must be 0"),
        ([""], "tenant is ''"),
        (["a]\n[b"], "it must be a name of printable characters"),
    ],
)
def test_invalid_arguments_fail_with_a_message(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert complaint in capsys.readouterr().err
