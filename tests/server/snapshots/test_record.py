"""Records: whole or not at all."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.snapshots.record import MAX_BYTES, RecordRefused, SessionRecord, read_record, write_record
from tests.server.snapshots.records import a_record


def test_a_record_comes_back_as_it_was_written() -> None:
    record = a_record()
    again = read_record(write_record(record))
    assert write_record(again) == write_record(record)
    assert np.array_equal(again.snapshot.rows, record.snapshot.rows)
    assert again.snapshot.rows.flags.writeable, "torch takes no other"
    assert again.opened == record.opened
    assert again.answers == record.answers
    assert again.snapshot.spec.seed == 1 << 63
    assert again.unanswered == {4}


def test_a_changed_byte_is_found_wherever_it_is() -> None:
    data, rng = write_record(a_record()), random.Random(5)
    for index in [*range(64), *rng.sample(range(len(data)), 400)]:
        damaged = bytearray(data)
        damaged[index] ^= 1 << rng.randrange(8)
        with pytest.raises(RecordRefused):
            read_record(bytes(damaged))


def test_what_is_cut_off_or_no_record_is_refused() -> None:
    data = write_record(a_record())
    for length in (0, 3, 4, 5, 20, 37, len(data) - 1):
        with pytest.raises(RecordRefused):
            read_record(data[:length])
    with pytest.raises(RecordRefused, match="no record"):
        read_record(b"\x80\x04\x95" + data)  # as a pickle would begin


def test_another_version_says_so() -> None:
    data = bytearray(write_record(a_record()))
    data[4] += 1
    with pytest.raises(RecordRefused, match="another version"):
        read_record(bytes(data))


def test_a_record_that_is_too_big_is_refused() -> None:
    record = a_record()
    rows = np.zeros((MAX_BYTES // 48 + 1, 12), np.float32)
    big: SessionRecord = replace(record, snapshot=replace(record.snapshot, rows=rows))
    with pytest.raises(RecordRefused, match="at most"):
        write_record(big)
