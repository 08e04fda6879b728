"""The path of a session's events to the engine: encodes their prompts, keeps their order, and answers refusals."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import Callable, Container, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    Open,
    Outcome,
    Output,
    SessionKey,
    SetOptions,
)
from motiongen_server.engine.types.refusals import engine_restarting, session_closed, session_not_open, too_many_pending
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import LoadedModel
from motiongen_server.rpc.convert import UNENCODED, coding_of, engine_event, prompt_texts, warnings_of
from motiongen_server.rpc.errors.events import internal
from motiongen_server.rpc.sessions.encoding import encoded
from motiongen_server.rpc.sessions.entry import SessionEntry
from motiongen_server.text.turns import Asker

_log = logging.getLogger(__name__)

Embeddings = dict[str, NDArray[np.float32]]

SESSION_CLOSED = session_closed().reason
SESSION_NOT_OPEN = session_not_open(0).reason
_NO_SESSION = (SESSION_NOT_OPEN, engine_restarting(0.0).reason)
"""Reasons of refusals for events whose session no engine has."""
MAX_WAITING_EVENTS = 64
"""Events of one session that may wait for a prompt to be encoded."""


def pass_on(entry: SessionEntry, event: session_pb2.SessionEvent, now: float) -> None:
    """Submit an event at once if no other of its session waits and its prompts are cached; else queue it.

    now: when it was read. Raises EventRefused.
    """
    if len(entry.waiting) >= MAX_WAITING_EVENTS and event.WhichOneof("event") != "close":
        raise too_many_pending("events", MAX_WAITING_EVENTS)
    texts = prompt_texts(event, entry.model.catalog)
    if not entry.waiting and entry.encoding is None:
        known = _known_embeddings(entry.model, texts)
        if known is not None:
            _submit(entry, event, now, known)
            return
    entry.place.peer.check_waiting(event.ByteSize())
    # Find everything that is wrong with it before anything is encoded for it, and before it waits.
    engine_event(event, entry.key, now, UNENCODED, entry.model.catalog)
    kept = session_pb2.SessionEvent()
    kept.CopyFrom(event)  # otherwise the whole message would stay in memory with it
    entry.wait_for_prompts(kept, now, texts)
    if entry.encoding is None:
        entry.encoding = asyncio.get_running_loop().create_task(_encode_waiting(entry))


def begin_end(entry: SessionEntry, reason: CloseReason) -> None:
    """A session is about to be closed: refuse events that wait for the encoder, or drop them if it continues elsewhere.

    The same then holds for events that come before the engine reports the end.
    """
    end = Closed(entry.key, reason, Code.OK, "", 0, 0)
    entry.is_leaving |= entry.goes_on_after(end)
    end_waiting(entry, end)  # the first may be the OpenSession itself, which is then refused


def close(entry: SessionEntry, reason: CloseReason, now: float) -> None:
    """Have a session's engine close it, after dealing with what waits; see `begin_end`."""
    begin_end(entry, reason)
    ask_to_close(entry, reason, now)


def ask_to_close(entry: SessionEntry, reason: CloseReason, now: float) -> None:
    """Have a session's engine close it."""
    entry.closing = True
    entry.model.engine.submit(Close(entry.key, entry.last_seq + 1, now, reason))


def end_waiting(entry: SessionEntry, closed: Closed) -> None:
    """Before a session's end is told, refuse what waits for the encoder, or drop it if it continues elsewhere."""
    if entry.goes_on_after(closed):
        _drop_waiting(entry)
    else:
        refuse_waiting(entry)


def refuse_waiting(entry: SessionEntry) -> None:
    """Refuse events that wait for the encoder: their session is over."""
    for event in _drop_waiting(entry):
        entry.carrier.take(session_closed().outcome(entry.key, event.event_seq))


def _drop_waiting(entry: SessionEntry) -> list[session_pb2.SessionEvent]:
    """Remove events that wait for the encoder, and return them, oldest first."""
    if entry.encoding is not None and entry.encoding is not asyncio.current_task():
        entry.encoding.cancel()
    return entry.take_all_waiting()


def without_needless_refusals(
    outputs: Sequence[Output], entry_of: Callable[[SessionKey], SessionEntry | None]
) -> Sequence[Output]:
    """Outputs without the refusals that a session's end makes needless: it answers all events, or they are sent again
    elsewhere.

    These are refusals before the end of a session that continues elsewhere, and refusals of events that reached an
    engine after it had ended the session, or was lost with it. The end is then on its way, or has been told, and the
    handle already has its next session.
    """
    leaving = {
        said.session
        for said in outputs
        if isinstance(said, Closed) and (entry := entry_of(said.session)) is not None and entry.goes_on_after(said)
    }
    if not leaving and not any(isinstance(said, Outcome) and said.reason in _NO_SESSION for said in outputs):
        return outputs
    return [said for said in outputs if not (isinstance(said, Outcome) and _is_needless(said, leaving, entry_of))]


def _is_needless(
    said: Outcome, leaving: Container[SessionKey], entry_of: Callable[[SessionKey], SessionEntry | None]
) -> bool:
    if said.reason == SESSION_CLOSED:
        return said.session in leaving
    entry = entry_of(said.session)
    if entry is None or said.reason not in _NO_SESSION or said.event_seq == 1:
        return False
    return said.reason == SESSION_NOT_OPEN or entry.opened is not None  # else the open is refused, and this with it


def tell_internal_error(entry: SessionEntry, event_seq: int, error: Exception) -> None:
    """Answer an event with an error id, under which the log has what happened."""
    error_id = secrets.token_hex(4)
    _log.error("event failed, error id %s", error_id, exc_info=error)
    entry.carrier.take(internal(error_id).outcome(entry.key, event_seq))


def _known_embeddings(model: LoadedModel, texts: Sequence[str]) -> Embeddings | None:
    known = {}
    for text in texts:
        embedding = model.prompts.cached(text)
        if embedding is None:
            return None
        known[text] = embedding
    return known


async def _encode_waiting(entry: SessionEntry) -> None:
    asker = Asker(entry.place.peer.name, entry.key.stream)
    try:
        while entry.waiting:
            # It stays in the queue while it is encoded, so that `refuse_waiting` finds it.
            event, received_at, texts = entry.waiting[0]
            embeddings: Embeddings = {}
            failure: Exception | None = None
            try:
                if not entry.closing:
                    embeddings = await encoded(entry.model.prompts, texts, asker, entry.place.prompts)
            except Exception as error:
                failure = error
            if not entry.waiting or entry.waiting[0][0] is not event:
                return  # its session ended meanwhile, and it was answered
            entry.take_waiting()
            try:
                if failure is not None:
                    raise failure
                with entry.carrier.work:
                    _submit(entry, event, received_at, embeddings)
            except EventRefused as refusal:
                entry.carrier.take(refusal.outcome(entry.key, event.event_seq))
            except Exception as error:
                tell_internal_error(entry, event.event_seq, error)
    finally:
        if entry.encoding is asyncio.current_task():
            entry.encoding = None
        entry.carrier.take()  # a stream that is ending may have waited only for this


def _submit(entry: SessionEntry, message: session_pb2.SessionEvent, now: float, embeddings: Embeddings) -> None:
    if entry.closing:
        raise session_closed()
    event = engine_event(message, entry.key, now, embeddings, entry.model.catalog)
    if isinstance(event, SetOptions):
        steps = event.denoise_steps
        steps_hz = None if steps is None else entry.model.steps_hz(steps)
        entry.asked_options[message.event_seq] = event, entry.place.change(event.priority, steps_hz)
    warnings = warnings_of(message, event, entry.model.catalog)
    if warnings:
        entry.warnings[message.event_seq] = warnings
    entry.closing = isinstance(event, Close)
    if isinstance(event, Open):
        entry.coding = coding_of(message.open, entry.model.catalog)
        entry.place.begin_steps(entry.model.steps_hz(event.spec.denoise_steps))
        event = replace(event, spec=replace(event.spec, owner=entry.place.peer.owner))
    entry.known_to_engine = True
    refusal = entry.model.engine.submit(event)
    if refusal is not None:
        entry.carrier.take_now(refusal)
