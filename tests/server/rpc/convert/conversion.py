"""Conversions of messages to events and of outputs to messages, in one call each."""

from __future__ import annotations

import numpy as np

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import (
    Event,
    Guidance,
    Output,
    SessionKey,
)
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event, playhead_of, prompt_texts, write_update
from motiongen_server.rpc.limits import Limits
from tests.server.engine.fakes import FACTS

KEY = SessionKey(3, 9)


CATALOG = Catalog(FACTS, Limits(), Guidance(1.5, 2.5), "CC0-1.0", text_encoder="hashed-1", history_frames=16)


def convert(event: session_pb2.SessionEvent) -> Event:
    if event.HasField("playhead"):
        return playhead_of(event.playhead, KEY, 12.5, None)
    texts = prompt_texts(event, CATALOG)
    return engine_event(event, KEY, 12.5, {text: np.full(2, len(text), np.float32) for text in texts}, CATALOG)


def updated(output: Output) -> session_pb2.SessionUpdate:
    update = session_pb2.SessionUpdate()
    write_update(update, output)
    return update


def attempt(event: session_pb2.SessionEvent) -> Event | EventRefused:
    try:
        return convert(event)
    except EventRefused as refusal:
        return refusal
