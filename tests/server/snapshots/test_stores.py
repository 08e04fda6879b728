"""Which store the settings ask for."""

from __future__ import annotations

from pathlib import Path

import pytest

from motiongen_server.settings import SettingError
from motiongen_server.snapshots.stores import is_for_several_servers, open_snapshot_store, state_folder

KEEP_S = 60.0


@pytest.mark.parametrize(
    "asked",
    [
        "file.sqlite",
        "sqlite::memory:",
        "http://localhost",
        "redis://localhost:port",
        "redis://localhost/0?timeout=3",
        "redis://localhost/0?ssl_cert_reqs=none",
        "redis://localhost/0?decode_responses=true",
        "rediss://localhost/0?ssl_cert_reqs=bogus",
    ],
)
def test_unknown_store_is_a_setting_error(asked: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="snapshot_store"):
        open_snapshot_store(asked, KEEP_S, tmp_path)


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("redi://user:secret@localhost:7000/2", "...@localhost:7000/2"),
        ("unx:///run/redis.sock?password=secret", "unx:///run/redis.sock"),
        ("redis://:secret#of-mine@localhost:7000/2", "# as %23"),
    ],
)
def test_refusal_of_a_misspelled_address_names_it_without_password(asked: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="snapshot_store") as refused:
        open_snapshot_store(asked, KEEP_S, tmp_path)
    assert told in str(refused.value)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    "asked",
    [
        "valkey://user:hush@localhost:6379/0",
        "redis://user:hush/hush@localhost:6379/0",
        "redis://user:hush#hush@localhost",
        "redis://user:hush?hush@localhost",
        "redis://user:12/hush@localhost",
        "redis://user:hush[hush@localhost",
        "rediss://user:hush@localhost/0?ssl_cert_reqs=bogus",
    ],
)
def test_refusal_of_a_store_does_not_reveal_its_password(asked: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="snapshot_store") as refused:
        open_snapshot_store(asked, KEEP_S, tmp_path)
    assert "hush" not in str(refused.value)


def test_store_is_the_one_that_the_setting_names(tmp_path: Path) -> None:
    assert open_snapshot_store("none", KEEP_S, tmp_path) is None
    for asked in ("auto", "sqlite:"):
        assert (
            str(open_snapshot_store(asked, KEEP_S, tmp_path / "state")) == f"sqlite:{tmp_path}/state/snapshots.sqlite"
        )
    named = open_snapshot_store(f"sqlite:{tmp_path}/named", KEEP_S, tmp_path)
    assert str(named) == f"sqlite:{tmp_path}/named"
    redis = open_snapshot_store("redis://:secret@localhost:7000/2", KEEP_S, tmp_path)
    assert str(redis) == "redis://localhost:7000/2"
    for url, name in (
        ("unix:///run/redis.sock?db=1", "unix:///run/redis.sock"),
        ("redis://[::1]", "redis://[::1]:6379"),
    ):
        assert str(open_snapshot_store(url, KEEP_S, tmp_path)) == name
    for options in ("redis://localhost/0?max_connections=1", "rediss://localhost/0?ssl_cert_reqs=none"):
        assert open_snapshot_store(options, KEEP_S, tmp_path) is not None


def test_unwritable_folder_is_an_error_only_if_a_file_was_asked_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "state").write_text("a file where the folder should be")
    assert open_snapshot_store("auto", KEEP_S, tmp_path / "state") is None
    assert "sessions end with this server" in caplog.text
    with pytest.raises(SettingError, match="cannot be used"):
        open_snapshot_store("sqlite:", KEEP_S, tmp_path / "state")


@pytest.mark.parametrize(
    ("asked", "is_shared"),
    [
        ("auto", False),
        ("none", False),
        ("sqlite:x", False),
        ("redis://a", True),
        ("rediss://a", True),
        ("unix:///a", True),
    ],
)
def test_only_redis_stores_are_for_several_servers(asked: str, is_shared: bool) -> None:
    assert is_for_several_servers(asked) is is_shared


@pytest.mark.parametrize(
    ("asked", "environment", "folder"),
    [
        ("/var/lib/motion", {"XDG_STATE_HOME": "/state"}, "/var/lib/motion"),
        ("", {"XDG_STATE_HOME": "/state"}, "/state/motiongen"),
        ("", {}, str(Path("~/.local/state/motiongen").expanduser())),
    ],
)
def test_state_folder_is_the_setting_or_the_user_s_default(
    asked: str, environment: dict[str, str], folder: str
) -> None:
    assert str(state_folder(asked, environment)) == folder
