"""Records are read completely or not at all."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.snapshots import record as record_module
from motiongen_server.snapshots.record import MAX_BYTES, RecordRefused, SessionRecord, read_record, write_record
from tests.server.snapshots.records import RECORDS, a_record


def test_record_is_read_as_it_was_written() -> None:
    record = a_record()
    again = read_record(write_record(record))
    assert write_record(again) == write_record(record)
    assert np.array_equal(again.snapshot.rows, record.snapshot.rows)
    assert again.snapshot.rows.flags.writeable, "torch needs writable arrays"
    assert again.opened == record.opened
    assert again.answers == record.answers
    assert again.snapshot.spec.seed == 1 << 63
    assert again.unanswered == {4}


def test_changed_bit_anywhere_is_detected() -> None:
    data, rng = write_record(a_record()), random.Random(5)
    for index in [*range(64), *rng.sample(range(len(data)), 400)]:
        damaged = bytearray(data)
        damaged[index] ^= 1 << rng.randrange(8)
        with pytest.raises(RecordRefused):
            read_record(bytes(damaged))


def test_truncated_record_and_other_data_are_refused() -> None:
    data = write_record(a_record())
    for length in (0, 3, 4, 5, 20, 37, len(data) - 1):
        with pytest.raises(RecordRefused):
            read_record(data[:length])
    with pytest.raises(RecordRefused, match="not the record"):
        read_record(b"\x80\x04\x95" + data)  # begins as a pickle does


@pytest.mark.parametrize("place", [4, 5, 20], ids=["version", "schema", "the schema's end"])
def test_record_of_an_unknown_version_is_refused_naming_the_versions(place: int) -> None:
    data = bytearray(write_record(a_record()))
    data[place] = ord("7") if data[place] != ord("7") else ord("8")
    with pytest.raises(RecordRefused, match="another version of the server, in the form") as refused:
        read_record(bytes(data))
    assert "this one reads 1/" in str(refused.value)


def test_records_of_the_previous_version_are_read() -> None:
    """At a release, `python -m tests.server.snapshots.records` saves one of that version."""
    kept = sorted(RECORDS.glob("*.bin"))
    assert {path.stem for path in kept} == record_module.ALSO_READ
    for path in kept:
        read, now = read_record(path.read_bytes()), a_record()
        assert np.array_equal(read.snapshot.rows, now.snapshot.rows)
        assert (read.tenant, read.taken_seq, read.unanswered) == (now.tenant, now.taken_seq, now.unanswered)
        assert (read.opened, read.answers, read.warnings) == (now.opened, now.answers, now.warnings)
        assert [type(each) for each in read.snapshot.constraints] == [type(each) for each in now.snapshot.constraints]
        assert read.snapshot.spec.outputs == ()
        assert write_record(read) == write_record(now), "fields added since have their defaults"


def test_record_that_is_too_large_is_refused() -> None:
    record = a_record()
    rows = np.zeros((MAX_BYTES // 48 + 1, 12), np.float32)
    big: SessionRecord = replace(record, snapshot=replace(record.snapshot, rows=rows))
    with pytest.raises(RecordRefused, match="at most"):
        write_record(big)
