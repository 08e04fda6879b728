"""Continues another server's session here: restores its entry and its engine's state from a record."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import GoingOn, Open, SessionKey, SessionSnapshot
from motiongen_server.engine.types.going_on import check_going_on, check_told
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.token_bucket import TokenBucket
from motiongen_server.rpc.convert.frames import FrameCoding
from motiongen_server.rpc.errors.events import events_not_saved, resume_superseded, session_not_kept
from motiongen_server.rpc.sessions.durability import Durability, NotKept, lease_of
from motiongen_server.rpc.sessions.entry import Carrier, SessionEntry
from motiongen_server.rpc.sparing_log import SparingLog
from motiongen_server.snapshots.record import SessionRecord
from motiongen_server.text.turns import Asker

_log = SparingLog(logging.getLogger(__name__))  # any client can make tokens up


class NoRoom(Exception):
    """A session's model has failed here, or its engines have no room for it. refusal: what its client is told."""

    def __init__(self, refusal: EventRefused, model: LoadedModel) -> None:
        super().__init__(str(refusal))
        self.refusal = refusal
        self.model = model


async def claimed(
    durability: Durability, opening: session_pb2.OpenSession, peer: Peer, models: ModelRegistry, asker: Asker
) -> tuple[str, SessionRecord]:
    """Claim the session of an OpenSession's resume token; returns its new token and its record, which no other server
    writes from now on.

    Raises EventRefused if there is no record, or it lacks events that the client knows to be answered (acknowledged
    events are never lost); if the model here cannot continue it, or its peer has no place or no steps for it; and if
    the store does not answer. Raises NoRoom if the model has failed or its engines have no room. A resume that is
    refused, or that was delayed until a newer attempt had been made, takes nothing away from the server that has the
    session.
    """
    point = opening.resume_point

    def check(record: SessionRecord) -> None:
        if point.attempt <= record.attempt:
            raise resume_superseded(point.attempt, record.attempt)
        model = models.named(record.snapshot.spec.model_id)
        facts = model.catalog.facts
        if record.taken_seq < point.answered_seq:
            raise events_not_saved(record.taken_seq, point.answered_seq)
        check_told(record.opened, facts)
        check_going_on(_going_on(record.snapshot, point), facts)
        _check_room(record.snapshot, model, peer)

    try:
        return await durability.take_over(opening.resume_token, peer.tenant, asker, check)
    except NotKept as error:
        _log.info("a session cannot be continued: %s", error)
        raise session_not_kept() from error


def _check_room(snapshot: SessionSnapshot, model: LoadedModel, peer: Peer) -> None:
    """Raises what `adopted` raises for lack of a place or of steps, and NoRoom."""
    if model.refusal is not None:
        raise NoRoom(model.refusal, model)
    spec = snapshot.spec
    place = peer.place(spec.priority, time.monotonic())
    try:
        place.begin_steps(model.steps_hz(spec.denoise_steps))
    finally:
        place.release()
    refusal = model.engine.refusal_of(spec.priority, spec.denoise_steps)
    if refusal is not None:
        raise NoRoom(refusal, model)


def adopted(
    record: SessionRecord,
    token: str,
    opening: session_pb2.OpenSession,
    key: SessionKey,
    *,
    models: ModelRegistry,
    peer: Peer,
    carrier: Carrier,
    events_per_second: float,
    now: float,
) -> tuple[SessionEntry, Open]:
    """The entry of a session that was taken over, on the stream and handle of the key, and the Open for its engine.

    Raises EventRefused if its model is not served, or its peer has no place or no steps for it.
    """
    snapshot, point = record.snapshot, opening.resume_point
    model = models.find(snapshot.spec.model_id)
    spec = replace(snapshot.spec, session=key, gaits=model.catalog.gaits, owner=peer.owner)
    place, bucket = peer.place(spec.priority, now), TokenBucket(events_per_second, now)
    try:
        place.begin_steps(model.steps_hz(spec.denoise_steps))
    except EventRefused:
        place.release()
        raise
    entry = SessionEntry(key, model, record.request_id, bucket, carrier, key.handle, place)
    entry.token, entry.attempt = token, point.attempt
    entry.told_epoch = lease_of(opening.resume_token).epoch
    entry.is_resuming = entry.known_to_engine = True
    entry.last_seq = record.taken_seq
    unanswered = record.unanswered
    entry.applied_seq = min(unanswered, default=record.taken_seq + 1) - 1
    entry.answered = {seq for seq in range(entry.applied_seq + 1, record.taken_seq + 1) if seq not in unanswered}
    entry.warnings = dict(record.warnings)
    entry.coding = FrameCoding(
        record.opened.scalar_type, len(model.catalog.facts.rig.joint_names), record.opened.outputs
    )
    entry.opened = replace(record.opened, session=key, session_token=token)
    entry.level = None if record.level is None else replace(record.level, session=key)
    for answer in record.answers:
        entry.answers.keep(replace(answer, session=key))
    entry.sent_to = point.next_frame
    entry.reached.extend((replace(each, session=key), point.next_frame) for each in record.reached)
    entry.confirm(point.answered_seq)
    return entry, Open(spec, 1, now, _going_on(snapshot, point))


def _going_on(snapshot: SessionSnapshot, point: session_pb2.ResumePoint) -> GoingOn:
    held_to = point.next_frame  # a client that does not say what it shows may show all that it holds
    playhead = point.playhead if point.HasField("playhead") else held_to
    committed_to = point.committed_to if point.HasField("committed_to") else held_to
    return GoingOn(snapshot, point.attempt, point.next_frame, point.plan, playhead, committed_to)
