"""Warnings about what a model was not trained for: in outcomes and in the log."""

from __future__ import annotations

import logging

import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_client import LocomotionPreset, ModelWarning, MotionClient, convert
from tests.client.fake_server import FakeServer

SAID = session_pb2.EventWarning(
    reason="PROMPT_OUTSIDE_DOMAIN", message="'jump' is outside", field="open.prompts[0].text"
)
HEARD = ModelWarning("PROMPT_OUTSIDE_DOMAIN", "'jump' is outside", "open.prompts[0].text")


def test_outcomes_and_openings_carry_warnings() -> None:
    outcome = convert.outcome(session_pb2.EditOutcome(event_seq=3, warnings=[SAID]), "an edit")
    assert not isinstance(outcome, Exception)
    assert outcome.warnings == (HEARD,)
    assert convert.opened(session_pb2.SessionOpened(warnings=[SAID])).warnings == (HEARD,)
    assert convert.opened(session_pb2.SessionOpened()).warnings == ()


def test_catalogue_says_what_a_model_was_trained_for() -> None:
    model = service_pb2.Model(
        presets=[service_pb2.Preset(preset_id="walk", text="walk on", description="walks")],
        constraint_forms=[
            service_pb2.ConstraintForm(form="hands", support=service_pb2.FORM_SUPPORT_UNTRAINED),
            service_pb2.ConstraintForm(form="feet", support=99),  # type: ignore[arg-type]  # of a later version
        ],
        locomotion_presets=[
            service_pb2.LocomotionPreset(
                name="run", text="run on", from_speed_mps=2, direction="forward", to_speed_mps=3
            )
        ],
        known_motions=["walking"],
    )
    (read,) = convert.catalog(service_pb2.GetCatalogResponse(models=[model])).models
    assert read.preset_descriptions == {"walk": "walks"}
    assert read.constraint_forms == {"hands": "untrained", "feet": "unspecified"}
    assert read.locomotion_presets == (LocomotionPreset("run", "run on", 2.0, "forward", 3.0),)
    assert read.known_motions == ("walking",)


async def test_warnings_of_an_edit_are_in_its_outcome_and_logged(
    server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    async with MotionClient(server.address) as client, await client.open("a person walks") as session:
        server.stream.warnings = [SAID]
        with caplog.at_level(logging.WARNING, "motiongen_client"):
            outcome = await session.set_prompt("jump")
        assert outcome.warnings == (HEARD,)
        assert "'jump' is outside" in caplog.text
        server.stream.warnings = []
        assert (await session.set_velocity(0, 1, keep_prompt=True)).warnings == ()
        assert server.stream.received[-1].set_velocity.keep_prompt


async def test_repeated_warnings_are_logged_once_each(server: FakeServer, caplog: pytest.LogCaptureFixture) -> None:
    said = [
        session_pb2.EventWarning(reason="UNTRAINED_SPEED", message=f"too fast {way}", field="set_velocity")
        for way in ("left", "right")
    ]
    async with MotionClient(server.address) as client, await client.open("a person walks") as session:
        server.stream.warnings = said
        with caplog.at_level(logging.WARNING, "motiongen_client"):
            for _ in range(5):
                assert len((await session.set_velocity(0, 1)).warnings) == 2
    assert [record.getMessage().split(": ")[1] for record in caplog.records] == ["too fast left", "too fast right"]
