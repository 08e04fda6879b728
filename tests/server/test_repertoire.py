"""What a server offers of a checkpoint's capabilities, given its text encoder."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from motiongen_ardy.capabilities import Capabilities, LocomotionPreset, PresetPrompt
from motiongen_ardy.text.domain import PromptDomain
from motiongen_server.engine.types import Direction
from motiongen_server.engine_process.messages import TO_GATEWAY, Ready
from motiongen_server.models.repertoire import as_abilities, encoded
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, FormSupport
from tests.contract.local import LengthEncoder
from tests.server.engine.fakes import FACTS

DOMAIN = PromptDomain("length-1", np.zeros(2, np.float32), np.eye(2, dtype=np.float32), 0.25)
WHOLE = Capabilities(
    forms={"hands": "warn", "feet": "refuse", "waypoint": "trained"},
    presets=(PresetPrompt("walk", "walk on", "walks"),),
    locomotion=(LocomotionPreset("back", "go back", 0.2, "backward", 1.5),),
    knows=("walking",),
    domain=DOMAIN,
)


class AwayEncoder(LengthEncoder):
    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        raise ConnectionError("it is away")


class OtherEncoder(LengthEncoder):
    identity = "other"


def test_presets_and_gaits_are_encoded_and_forms_translated() -> None:
    found = encoded(as_abilities(WHOLE), LengthEncoder(), "m")
    (preset,), (gait,) = found.presets, found.gaits
    assert (preset.preset_id, preset.description, preset.embedding[0]) == ("walk", "walks", len("walk on"))
    assert (gait.direction, gait.from_mps, gait.embedding[0]) == (Direction.BACKWARD, 0.2, len("go back"))
    assert found.abilities.fastest_mps(Direction.BACKWARD) == 1.5
    assert list(found.abilities.forms.values()) == [FormSupport.UNTRAINED, FormSupport.REFUSED, FormSupport.TRAINED]
    assert found.abilities.domain is not None


def test_another_encoder_drops_presets_gaits_and_the_domain(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = encoded(as_abilities(WHOLE), OtherEncoder(), "m")
    assert (found.presets, found.gaits, found.abilities.domain) == ((), (), None)
    assert found.abilities.forms["feet"] is FormSupport.REFUSED
    assert "length-1, not other" in caplog.text


def test_distance_of_a_prompt_from_the_captions_equals_the_library_s() -> None:
    directions = np.array([[0.6, 0.8, 0], [0, -1, 0]], np.float32)
    library = PromptDomain("length-1", np.array([0.25, 0.5, -0.125], np.float32), directions, 0.25)
    domain = as_abilities(Capabilities(domain=library)).domain
    assert domain is not None
    prompts = np.array([[3, 4, 0], [0, 0, 2], [-0.5, 0.25, 0.1], [0, 0, 0]], np.float32)
    distances = [domain.distance(prompt) for prompt in prompts]
    assert distances == pytest.approx(library.distances(prompts).tolist(), abs=1e-6)
    assert [domain.is_outside(prompt) for prompt in prompts] == [distance > 0.25 for distance in distances]
    assert {True, False} == {domain.is_outside(prompt) for prompt in prompts}


def test_unavailable_encoder_drops_only_presets_and_gaits(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = encoded(as_abilities(WHOLE), AwayEncoder(), "m")
    assert (found.presets, found.gaits) == ((), ())
    assert found.abilities.domain is not None
    assert "it is away" in caplog.text


def test_checkpoint_without_claims_does_not_call_the_encoder() -> None:
    found = encoded(as_abilities(Capabilities()), AwayEncoder(), "m")
    assert (found.presets, found.gaits, dict(found.abilities.forms)) == ((), (), dict(NOTHING_CLAIMED.forms))


def test_abilities_survive_the_message_to_the_gateway() -> None:
    abilities = as_abilities(WHOLE)
    ready = TO_GATEWAY.decode(TO_GATEWAY.encode(Ready(0, FACTS, "CC0-1.0", abilities)))
    assert isinstance(ready, Ready)
    assert dict(ready.abilities.forms) == dict(abilities.forms)
    assert (tuple(ready.abilities.presets), tuple(ready.abilities.gaits)) == (abilities.presets, abilities.gaits)
    assert ready.abilities.domain is not None
    np.testing.assert_array_equal(ready.abilities.domain.directions, DOMAIN.directions)
