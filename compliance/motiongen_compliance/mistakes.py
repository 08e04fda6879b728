"""Mistakes in events, and the answers to them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import grpc

from motiongen.v1 import service_pb2, session_pb2

Event = session_pb2.SessionEvent
Catalog = service_pb2.GetCatalogResponse
Status = grpc.StatusCode
NAN, INF = math.nan, math.inf


@dataclass(frozen=True)
class Mistake:
    """An event, made for a server's catalogue, and the answer to it. allowed: words that the answer must contain."""

    name: str
    make: Callable[[Catalog], Event]
    reason: str
    field: str
    allowed: str
    code: Status = Status.INVALID_ARGUMENT


def opening(**fields: object) -> Event:
    return Event(open=session_pb2.OpenSession(**fields))  # type: ignore[arg-type]


def long_text(catalog: Catalog) -> str:
    return "a" * max(10_000, catalog.limits.max_prompt_characters + 1)


def check(outcome: session_pb2.EditOutcome, mistake: Mistake) -> None:
    told = (outcome.code, outcome.reason, outcome.field)
    assert told == (mistake.code.value[0], mistake.reason, mistake.field), outcome.message
    assert mistake.allowed in outcome.allowed
    assert outcome.allowed
    assert len(outcome.message) < 500, "a mistake is not sent back whole"
