"""Files that are read anew: also where others that they name come later than they do."""

from __future__ import annotations

from pathlib import Path

import pytest

from motiongen_server.identity import watched
from motiongen_server.identity.watched import Watched
from tests.waiting import LIMIT_S


def test_what_could_not_be_read_for_another_file_is_read_once_that_is_there(
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
    assert not files.look(), "it is not tried at every look"
    monkeypatch.setattr(watched, "RETRY_S", -1.0)  # for what fails from now on
    named.unlink()
    path.write_text("names another, again")
    assert not any(files.look() for _ in range(3))
    assert len(caplog.messages) == 2, "each change is told once"
    named.write_text("keys")
    assert files.look()
    assert files.value == "names another, again keys"


def test_whatever_reading_raises_what_was_read_before_holds_and_it_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "keys.json"
    path.write_text("good")

    def read() -> str:
        if path.read_text() != "odd":
            return path.read_text()
        raise TypeError("unhashable type: 'list'")

    monkeypatch.setattr(watched, "RETRY_S", -1.0)  # each look tries it again
    files = Watched("keys", [str(path)], read)
    path.write_text("odd")
    assert not any(files.look() for _ in range(5))
    assert files.value == "good"
    assert len(caplog.messages) == 1
    path.write_text("mended")
    assert files.look()
    assert files.value == "mended"


def test_what_is_written_while_it_is_read_is_read_whole_at_the_next_look(tmp_path: Path) -> None:
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
