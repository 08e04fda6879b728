"""The store of vectors on disk: what it finds, what it does not, and that its failures do no harm."""

from __future__ import annotations

import logging
import sqlite3
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.text.store import VectorStore, known_encoder

VECTOR = np.array([1.5, -2.25, 0, 1e-30], np.float32)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "prompts.db"


def store(path: Path, identity: str = "llm2vec-01-float32", width: int = 4, most: int = 100) -> VectorStore:
    return VectorStore(path, identity, width, most)


def test_a_stored_vector_is_found_after_reopening_the_store(path: Path) -> None:
    first = store(path)
    first.put("a person walks", VECTOR)
    first.close()
    second = store(path)
    found = second.get("a person walks")
    assert found is not None
    assert found.tobytes() == VECTOR.tobytes()
    assert second.get("a person walks ") is None
    second.close()


@given(
    st.dictionaries(
        st.text(), st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=4, max_size=4)
    )
)
def test_every_text_finds_its_own_vector(content: dict[str, list[float]]) -> None:
    manager = VectorStore(Path(":memory:"), "any", 4)
    for text, values in content.items():
        manager.put(text, np.array(values, np.float32))
    for text, values in content.items():
        np.testing.assert_array_equal(manager.get(text), np.array(values, np.float32))
    manager.close()


@pytest.mark.parametrize(
    ("identity", "width"), [("llm2vec-01-bfloat16", 4), ("llm2vec-02-float32", 4), ("llm2vec-01-float32", 3)]
)
def test_vectors_of_another_encoder_precision_or_width_are_not_found(path: Path, identity: str, width: int) -> None:
    first, second = store(path), store(path, identity, width)
    first.put("walk", VECTOR)
    assert second.get("walk") is None
    first.close()
    second.close()


def test_a_full_store_drops_the_least_recently_used_vectors(path: Path) -> None:
    manager = store(path, most=10)
    for number in range(11):
        manager.put(f"prompt {number}", VECTOR)
    assert [number for number in range(11) if manager.get(f"prompt {number}") is None] == [0, 1]
    manager.close()


def test_the_store_does_not_count_its_rows_for_every_vector(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    connect = sqlite3.connect

    def listened_to(*arguments: Any, **options: Any) -> sqlite3.Connection:
        connection: sqlite3.Connection = connect(*arguments, **options)
        connection.set_trace_callback(said.append)
        return connection

    monkeypatch.setattr(sqlite3, "connect", listened_to)
    manager = store(path, most=1000)
    for number in range(100):
        manager.put(f"prompt {number}", VECTOR)
    manager.close()
    counts = [statement for statement in said if "count(*)" in statement]
    assert 0 < len(counts) <= 10, "each reads the whole file, and requests wait for it"


def test_several_stores_can_write_to_one_file_at_once(path: Path) -> None:
    stores = [store(path, most=1000) for _ in range(3)]

    def fill(manager: VectorStore, offset: int) -> None:
        for number in range(20):
            manager.put(f"{offset} {number}", VECTOR * offset)

    threads = [threading.Thread(target=fill, args=(manager, offset)) for offset, manager in enumerate(stores)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for offset in range(3):
        for number in range(20):
            np.testing.assert_array_equal(stores[0].get(f"{offset} {number}"), VECTOR * offset)
    for manager in stores:
        manager.close()


def test_a_file_that_is_not_a_database_is_moved_aside(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path.parent.mkdir()
    path.write_bytes(b"not a database, but a letter to my aunt" * 100)
    manager = store(path)
    manager.put("walk", VECTOR)
    np.testing.assert_array_equal(manager.get("walk"), VECTOR)
    manager.close()
    assert path.with_name("prompts.db.broken").read_bytes().startswith(b"not a database")
    assert "prompts.db.broken" in caplog.text


def test_damaged_vectors_are_not_found(path: Path) -> None:
    manager = store(path)
    manager.put("short", VECTOR)
    manager.put("nan", VECTOR)
    manager.put("text", VECTOR)
    with sqlite3.connect(path) as other:
        other.execute("UPDATE vectors SET vector = x'0011' WHERE text = 'short'")
        other.execute("UPDATE vectors SET vector = ? WHERE text = 'nan'", (np.full(4, np.nan, "<f4").tobytes(),))
        other.execute("UPDATE vectors SET vector = 'abcdefghijklmnop' WHERE text = 'text'")
    other.close()
    assert [manager.get(text) for text in ("short", "nan", "text")] == [None, None, None]
    manager.close()


def test_values_of_another_type_are_not_found_and_reported_once(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    manager = store(path)
    manager.put("walk", VECTOR)
    manager.note_encoder("grpc:here")
    with sqlite3.connect(path) as other:
        other.execute("UPDATE vectors SET used_at = 'never'")
        other.execute("UPDATE encoders SET width = 'wide'")
    other.close()
    assert [manager.get("walk"), manager.get("walk"), known_encoder(path, "grpc:here")] == [None] * 3
    assert caplog.text.count("cannot be used") == 1
    manager.put("walk", VECTOR)
    assert manager.get("walk") is not None
    manager.close()


def test_a_store_of_another_version_is_left_alone(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    store(path).close()
    with sqlite3.connect(path) as other:
        other.execute("PRAGMA user_version = 99")
    other.close()
    manager = store(path)
    manager.put("walk", VECTOR)
    assert manager.get("walk") is None
    manager.close()
    assert "another version, 99" in caplog.text
    assert not path.with_name("prompts.db.broken").exists()


def test_a_store_that_cannot_be_opened_keeps_nothing_and_warns_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    with caplog.at_level(logging.WARNING):
        manager = store(tmp_path / "file" / "prompts.db")
        for _ in range(3):
            manager.put("walk", VECTOR)
            assert manager.get("walk") is None
        manager.close()
    assert len(caplog.records) == 1


def test_a_store_that_breaks_while_in_use_keeps_nothing_and_warns_once(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    manager = store(path)
    with sqlite3.connect(path) as other:
        other.execute("DROP TABLE vectors")
    other.close()
    manager.put("walk", VECTOR)
    assert manager.get("walk") is None
    manager.close()
    assert caplog.text.count("cannot be used") == 1


def test_the_latest_identity_of_an_encoder_is_known_after_reopening(path: Path) -> None:
    assert known_encoder(path, "grpc:here:1") is None
    for identity in ("llm2vec-01-float32", "llm2vec-02-float32"):
        manager = store(path, identity)
        manager.note_encoder("grpc:here:1")
        manager.close()
    assert known_encoder(path, "grpc:here:1") == ("llm2vec-02-float32", 4)
    assert known_encoder(path, "grpc:there:1") is None
    path.write_bytes(b"a letter")
    assert known_encoder(path, "grpc:here:1") is None
