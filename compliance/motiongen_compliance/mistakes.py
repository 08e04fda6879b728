"""Mistakes in events, and the answers that the protocol requires."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import grpc

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.messages import edit_prompts, span
from motiongen_compliance.target import Scene

Event = session_pb2.SessionEvent
Catalog = service_pb2.GetCatalogResponse
Status = grpc.StatusCode
NAN, INF = math.nan, math.inf


@dataclass(frozen=True)
class Mistake:
    """An event with a mistake, made for a server's catalogue, and the answer to it.

    allowed: words that the server of this repository uses in `EditOutcome.allowed`; other servers may use others.
    """

    name: str
    make: Callable[[Catalog], Event]
    reason: str
    field: str
    allowed: str = ""
    code: Status = Status.INVALID_ARGUMENT


def opening(**fields: object) -> Event:
    return Event(open=session_pb2.OpenSession(**fields))  # type: ignore[arg-type]


def long_text(catalog: Catalog) -> str:
    return "a" * max(10_000, catalog.limits.max_prompt_characters + 1)


def check(outcome: session_pb2.EditOutcome, mistake: Mistake) -> None:
    """Check an answer. The protocol fixes code, reason and field; the wording of `allowed` is up to the server."""
    told = (outcome.code, outcome.reason, outcome.field)
    assert told == (mistake.code.value[0], mistake.reason, mistake.field), f"{mistake.name}: {outcome.message}"
    assert outcome.allowed, f"{mistake.name}: the answer says what is allowed"
    assert len(outcome.message) < 500, "the answer does not repeat the whole mistake"


async def refuse_all(scene: Scene, mistakes: Sequence[Mistake]) -> None:
    """Send mistakes one after another in one session: each is answered, uses up its number, and changes nothing else.

    A constraint may also be refused because the model does not support its form.
    """
    talk, heard = scene.talk, scene.talk.sessions[1]
    takes_all = all(
        form.support != service_pb2.FORM_SUPPORT_REFUSED for form in talk.catalog.models[0].constraint_forms
    )
    for mistake in mistakes:
        outcome = await talk.edit(1, mistake.make(talk.catalog))
        if takes_all or outcome.reason != "UNSUPPORTED_CONSTRAINT":
            check(outcome, mistake)
        assert heard.applied_seq == heard.sent_seq, f"{mistake.name}: its number is used up"
    assert (await talk.edit(1, edit_prompts(span("a person goes on")))).code == 0
    await talk.plays_on(1)
    await scene.others_play_on()
