"""Mistakes in events, and the answers to them."""

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
    """An event, made for a server's catalogue, and the answer to it.

    allowed: words that the server of this repository says there; others need not.
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
    """Code, reason and field are the protocol's; in which words `allowed` says it is the server's own affair."""
    told = (outcome.code, outcome.reason, outcome.field)
    assert told == (mistake.code.value[0], mistake.reason, mistake.field), f"{mistake.name}: {outcome.message}"
    assert outcome.allowed, f"{mistake.name}: what would be allowed is said"
    assert len(outcome.message) < 500, "a mistake is not sent back whole"


async def refuse_all(scene: Scene, mistakes: Sequence[Mistake]) -> None:
    """Make mistakes one after another on one session: each is answered, uses its number up, and changes nothing else.

    A form of constraint that the model does not take may be refused for that.
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
