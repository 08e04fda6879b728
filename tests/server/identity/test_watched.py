"""Files that are read again when they change, also when a file that they name appears only later."""

from __future__ import annotations

from pathlib import Path

import pytest

from motiongen_server.identity import watched
from motiongen_server.identity.watched import Watched
from tests.waiting import LIMIT_S


def test_failed_read_is_retried_until_the_file_it_names_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path, named = tmp_path / "tenants.toml", tmp_path / "keys.json"
    path.write_text("first")

    def read() -> str:
        text = path.read_text()
        return text if text == "first" else f"{text} {named.read_text()}"

    monkeypatch.setattr(watched, "RETRY_S", LIMIT_S)
    files = Watched("tenants", [str(path)], read)
    path.write_text("names another")
    assert not files.look()
    named.write_text("keys")
    assert not files.look(), "the read is not retried at every look"
    monkeypatch.setattr(watched, "RETRY_S", -1.0)  # from now on a failed read is retried at once
    named.unlink()
    path.write_text("names another, again")
    assert not any(files.look() for _ in range(3))
    assert len(caplog.messages) == 2, "each change is logged once"
    named.write_text("keys")
    assert files.look()
    assert files.value == "names another, again keys"


def test_any_error_in_reading_keeps_the_old_value_and_is_logged_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "keys.json"
    path.write_text("good")

    def read() -> str:
        if path.read_text() != "odd":
            return path.read_text()
        raise TypeError("unhashable type: 'list'")

    monkeypatch.setattr(watched, "RETRY_S", -1.0)  # a failed read is retried at every look
    files = Watched("keys", [str(path)], read)
    path.write_text("odd")
    assert not any(files.look() for _ in range(5))
    assert files.value == "good"
    assert len(caplog.messages) == 1
    path.write_text("mended")
    assert files.look()
    assert files.value == "mended"


def test_file_changed_while_it_is_read_is_read_again_at_the_next_look(tmp_path: Path) -> None:
    path = tmp_path / "tenants.toml"
    path.write_text("first")
    coming: list[str] = []

    def read() -> str:
        text = path.read_text()
        if coming:
            path.write_text(coming.pop())
        return text

    files = Watched("tenants", [str(path)], read)
    path.write_text("begun")
    coming.append("begun, and ended")
    assert (files.look(), files.value) == (False, "first")
    assert (files.look(), files.value) == (True, "begun, and ended")
    assert not files.look()
