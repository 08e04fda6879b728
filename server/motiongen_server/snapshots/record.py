"""SessionRecord <-> the bytes that a store keeps: versioned, checked and bounded; nothing in them is ever executed."""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass

from motiongen_server.engine.types import ConstraintReached, Opened, Outcome, ServiceLevel, SessionSnapshot, Warned
from motiongen_server.engine_process.codec import Codec, CodecError

MAX_BYTES = 1 << 20
"""The limit for one record. With the built-in model a record takes about 40 KiB, most of it frames."""
_MAGIC = b"MGSS"
_VERSION = 1
_DIGEST_BYTES = 16
ALSO_READ = frozenset({"436d7c871f7a501f"})
"""Schemas of earlier servers whose records this one also reads: since then, classes have only gained fields with
defaults at their ends. `tests/data/records` has a record of each.
"""


class RecordRefused(ValueError):
    """Bytes that are not a complete, undamaged record of a version that can be read, or a record that is too large."""


@dataclass(frozen=True, slots=True, eq=False)
class SessionRecord:
    """A session as the edge and its engine know it.

    tenant: whose it is; other tenants never learn of it. taken_seq: the last event that has been taken. opened: without
    its token; level, answers, reached: what the client may not have received; warnings: by event, for unanswered ones.
    attempt: the last one to resume it. told_epoch: of the newest token that its client is known to have; the client may
    not have received newer ones.
    """

    tenant: str
    request_id: str
    taken_seq: int
    opened: Opened
    level: ServiceLevel | None
    answers: tuple[Outcome, ...]
    reached: tuple[ConstraintReached, ...]
    warnings: dict[int, tuple[Warned, ...]]
    attempt: int
    snapshot: SessionSnapshot
    told_epoch: int = 1

    @property
    def unanswered(self) -> frozenset[int]:
        """The events up to taken_seq that have no answer yet."""
        return frozenset(edit.event_seq for edit in self.snapshot.unanswered)


_CODEC: Codec[SessionRecord] = Codec(SessionRecord)
_BEGIN = _MAGIC + bytes([_VERSION])
_HEAD = _BEGIN + _CODEC.schema.encode()


def write_record(record: SessionRecord) -> bytes:
    """The bytes of a record. Raises RecordRefused if it is too large."""
    try:
        content = _CODEC.encode(record)
    except CodecError as error:
        raise RecordRefused(f"the session cannot be encoded: {error}") from error
    data = b"".join((_HEAD, _digest(content), content))
    if len(data) > MAX_BYTES:
        raise RecordRefused(f"the session takes {len(data)} bytes; at most {MAX_BYTES} are kept of one")
    return data


def read_record(data: bytes) -> SessionRecord:
    """The record in these bytes. Raises RecordRefused unless `write_record` of a readable version made them."""
    if len(data) > MAX_BYTES or not data.startswith(_MAGIC):
        raise RecordRefused(f"{len(data)} bytes are not the record of a session")
    schema = data[len(_BEGIN) : len(_HEAD)].decode("ascii", "replace")
    if not data.startswith(_BEGIN) or schema not in {_CODEC.schema, *ALSO_READ}:
        version = int.from_bytes(data[len(_MAGIC) : len(_BEGIN)], "big")
        raise RecordRefused(
            f"the session was saved by another version of the server, in the form {version}/{schema}; "
            f"this one reads {_VERSION}/{_CODEC.schema} and the one before it"
        )
    digest, content = data[len(_HEAD) : len(_HEAD) + _DIGEST_BYTES], data[len(_HEAD) + _DIGEST_BYTES :]
    if not hmac.compare_digest(digest, _digest(content)):
        raise RecordRefused("the record of the session is damaged")
    try:
        return _CODEC.decode(content)  # arrays are copies: the engine hands them to torch
    except CodecError as error:
        raise RecordRefused(str(error)) from error


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).digest()
