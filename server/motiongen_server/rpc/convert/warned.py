"""Warnings for events that are accepted although the model was not trained for what they ask."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import (
    Asked,
    Event,
    Open,
    Prompt,
    SetConstraints,
    SetPrompts,
    SetVelocity,
    Warned,
)
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.forms import untrained_forms
from motiongen_server.rpc.convert.speeds import too_fast_for

MAX_QUOTED = 80
"""Characters of a prompt that a warning repeats."""


def warnings_of(message: session_pb2.SessionEvent, event: Event, catalog: Catalog) -> tuple[Warned, ...]:
    """Warnings to send when the event is accepted. event: what `engine_event` made of the message."""
    match event:
        case Open():
            prompts = _prompt_warnings(message.open.prompts, event.spec.prompts, "open.prompts", catalog)
            return (*prompts, *_target_warnings(event.spec.constraints, "open.constraints[{}]", catalog))
        case SetPrompts():
            spans = message.edit_prompts.upsert
            return tuple(_prompt_warnings(spans, event.upsert, "edit_prompts.upsert", catalog))
        case SetConstraints():
            return tuple(_target_warnings(event.upsert, "edit_constraints.upsert[{}]", catalog))
        case SetVelocity():
            return tuple(_target_warnings((event,), "set_velocity", catalog))
    return ()


def _prompt_warnings(
    spans: Sequence[motion_pb2.PromptSpan], prompts: Sequence[Prompt], field: str, catalog: Catalog
) -> Iterable[Warned]:
    """Only texts are judged: clients that send an embedding or a preset's id know what it is."""
    domain = catalog.abilities.domain
    if domain is None:
        return
    known = ", ".join(catalog.abilities.known_motions)
    for index, (span, prompt) in enumerate(zip(spans, prompts, strict=True)):
        if span.preset_id or span.HasField("embedding") or not domain.is_outside(prompt.embedding):
            continue
        text = span.text if len(span.text) <= MAX_QUOTED else f"{span.text[: MAX_QUOTED - 3]}..."
        given = f"{catalog.facts.model_id} knows {known}; {text!r} is outside, and the motion may not show it"
        yield Warned("PROMPT_OUTSIDE_DOMAIN", given, f"{field}[{index}].text")


def _target_warnings(items: Sequence[Asked | SetVelocity], field: str, catalog: Catalog) -> Iterable[Warned]:
    """Warnings for the first item of each untrained form, and for the first item that is too fast."""
    for form, index in untrained_forms(items, catalog).items():
        given = f"{catalog.facts.model_id} was not trained for constraints of the form {form}, and may miss this one"
        yield Warned("UNTRAINED_CONSTRAINT", given, field.format(index))
    for index, item in enumerate(items):
        way = too_fast_for(item, catalog)
        if way is not None:  # does not name the speed asked for, which a stick changes ten times a second
            most = f"{way.name.lower()} at up to {catalog.abilities.fastest_mps(way):g} m/s"
            given = f"{catalog.facts.model_id} steps {most}; higher speeds are accepted, but feet may glide"
            yield Warned("UNTRAINED_SPEED", given, field.format(index))
            return
