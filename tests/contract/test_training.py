"""What a model was not trained for is refused, or accepted with a warning, without effect on other sessions."""

from __future__ import annotations

from collections.abc import AsyncIterator

import grpc
import numpy as np
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.messages import edit_constraints, edit_prompts, span, waypoint
from motiongen_compliance.target import Target, connect
from motiongen_server.engine.types import Direction, Gait
from motiongen_server.rpc.abilities import Abilities, FormSupport, PromptDomain
from tests.contract.local import LocalServer

OK = grpc.StatusCode.OK.value[0]
INVALID_ARGUMENT = grpc.StatusCode.INVALID_ARGUMENT.value[0]
FORMS = {"waypoint": FormSupport.TRAINED, "waypoint_heading": FormSupport.UNTRAINED, "velocity": FormSupport.TRAINED}
# The local server's encoder embeds a text as its length: more than 9 is outside the domain.
FAR = "sits down on a chair"
DOMAIN = PromptDomain("length-1", np.zeros(2, np.float32), np.array([[0, 1]], np.float32), 2.0)
STAND = Gait("stand", "stand still", 0.0, Direction.FORWARD, np.array([11, 0], np.float32))


class _Judge(PromptDomain):
    """Judges by the length of the text, since all vectors of the fake encoder have the same direction."""

    def distance(self, embedding: np.ndarray) -> float:
        return 3.0 if embedding[0] > 9 else 0.0


@pytest.fixture
async def trained() -> AsyncIterator[Target]:
    domain = _Judge(DOMAIN.text_encoder, DOMAIN.mean, DOMAIN.directions, DOMAIN.threshold)
    abilities = Abilities({**FORMS, "trajectory": FormSupport.REFUSED}, known_motions=("walking",), domain=domain)
    async with LocalServer(abilities=abilities, gaits=(STAND,)) as server:
        async for target in connect(server.address):
            yield target


def _reasons(said: session_pb2.EditOutcome | session_pb2.SessionOpened) -> list[str]:
    return [warning.reason for warning in said.warnings]


async def test_catalogue_lists_what_the_model_was_trained_for(trained: Target) -> None:
    (model,) = trained.catalog.models
    support = {form.form: form.support for form in model.constraint_forms}
    assert support["waypoint"] == service_pb2.FORM_SUPPORT_TRAINED
    assert support["trajectory"] == service_pb2.FORM_SUPPORT_REFUSED
    assert [(gait.name, gait.direction) for gait in model.locomotion_presets] == [("stand", "forward")]
    assert list(model.known_motions) == ["walking"]


async def test_open_gets_its_warnings(trained: Target) -> None:
    talk = await trained.talk()
    heard = await talk.open(1, prompts=[span(FAR)], constraints=[waypoint(90, heading=1.0)])
    assert heard.opened is not None
    assert _reasons(heard.opened) == ["PROMPT_OUTSIDE_DOMAIN", "UNTRAINED_CONSTRAINT"]
    assert FAR in heard.opened.warnings[0].message
    assert heard.opened.warnings[0].field == "open.prompts[0].text"
    other = await talk.open(2, prompts=[span("walk")])
    assert other.opened is not None
    assert _reasons(other.opened) == []


async def test_each_edit_gets_its_own_warnings(trained: Target) -> None:
    talk = await trained.talk()
    await talk.open(1)
    for event, reasons in (
        (edit_prompts(span(FAR)), ["PROMPT_OUTSIDE_DOMAIN"]),
        (edit_prompts(span("walk")), []),
        (edit_constraints(waypoint(400, heading=1.0)), ["UNTRAINED_CONSTRAINT"]),
        (edit_constraints(waypoint(400)), []),
    ):
        outcome = await talk.edit(1, event)
        assert (outcome.code, _reasons(outcome)) == (OK, reasons)


async def test_refused_event_has_no_warnings_and_leaves_others_alone(trained: Target) -> None:
    talk = await trained.talk()
    await talk.open(1)
    await talk.open(2)
    outcome = await talk.edit(1, edit_prompts(span(FAR), remove=[77]))
    assert (outcome.reason, _reasons(outcome)) == ("UNKNOWN_PROMPT", [])
    path = waypoint(400)
    path.root_trajectory.positions.extend([0, 0, 0, 1])
    outcome = await talk.edit(1, edit_constraints(path))
    assert (outcome.code, outcome.reason, outcome.field) == (
        INVALID_ARGUMENT,
        "UNSUPPORTED_CONSTRAINT",
        "edit_constraints.upsert[0]",
    )
    assert "trajectory" in outcome.message
    await talk.plays_on(1)
    await talk.plays_on(2)


async def test_every_sample_of_a_clip_gets_the_warnings(trained: Target) -> None:
    opening = session_pb2.OpenSession(prompts=[span(FAR)])
    request = service_pb2.GenerateClipRequest(open=opening, frame_count=8, sample_count=2)
    opened = {}
    async for response in trained.stub.GenerateClip(request):
        if response.HasField("opened"):
            opened[response.sample] = _reasons(response.opened)
    assert opened == {0: ["PROMPT_OUTSIDE_DOMAIN"], 1: ["PROMPT_OUTSIDE_DOMAIN"]}


@pytest.mark.parametrize("keep_prompt", [False, True])
async def test_velocity_is_accepted_with_and_without_its_gait(trained: Target, keep_prompt: bool) -> None:
    talk = await trained.talk()
    await talk.open(1, prompts=[span("walk")])
    velocity = session_pb2.SetVelocity(hold_frames=30, keep_prompt=keep_prompt)
    outcome = await talk.edit(1, session_pb2.SessionEvent(set_velocity=velocity))
    assert (outcome.code, outcome.HasField("effective_frame")) == (OK, True)
    await talk.plays_on(1)
