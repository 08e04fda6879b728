"""Which model an OpenSession gets, and what the catalogue lists when there are several."""

from __future__ import annotations

from dataclasses import replace

import pytest

from motiongen_server.engine.types import Code, Guidance, ModelFacts
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.errors.events import model_failed
from motiongen_server.rpc.limits import Limits
from motiongen_server.text.prompts import PromptEncoder
from tests.contract.local import LengthEncoder
from tests.server.engine.fakes import FACTS


class NoEngine:
    free_share = 0.25

    def submit(self, event: object) -> None:
        raise AssertionError("an event was submitted")


def served(model_id: str, rig_id: str = "fake") -> LoadedModel:
    facts: ModelFacts = replace(FACTS, model_id=model_id, rig=replace(FACTS.rig, rig_id=rig_id))
    catalog = Catalog(facts, Limits(), Guidance(2.0, 2.0), "CC0-1.0", text_encoder="length-1", history_frames=16)
    return LoadedModel(model_id, NoEngine(), PromptEncoder(LengthEncoder(), 1), catalog)


def test_first_model_is_the_default_and_others_are_found_by_name() -> None:
    first, second = served("one"), served("two")
    models = ModelRegistry(first)
    models.put(second)
    assert [models.find(name) for name in ("", "one", "two")] == [first, first, second]


def test_unknown_model_is_refused_with_the_names_of_those_served() -> None:
    models = ModelRegistry(served("one"))
    models.put(served("two"))
    with pytest.raises(EventRefused, match="no model 'three' is served") as refused:
        models.find("three")
    assert (refused.value.code, refused.value.reason) == (Code.NOT_FOUND, "UNKNOWN_MODEL")
    assert (refused.value.field, refused.value.allowed) == ("open.model_id", "one, two")


def test_refusal_repeats_only_the_beginning_of_a_very_long_name() -> None:
    with pytest.raises(EventRefused) as refused:
        ModelRegistry(served("one")).find("m" * 5_000)
    assert len(str(refused.value)) < 300


def test_model_that_takes_no_sessions_gives_its_refusal() -> None:
    first = served("one")
    models = ModelRegistry(first)
    models.put(served("two"))
    first.refusal = model_failed("one", "its engine has failed")
    for name in ("", "one"):
        with pytest.raises(EventRefused) as refused:
            models.find(name)
        assert refused.value.reason == "MODEL_FAILED"
    assert models.find("two").model_id == "two"


def test_catalogue_lists_all_models_and_each_rig_once() -> None:
    models = ModelRegistry(served("one"))
    before = models.catalog_response("")
    models.put(served("two"))
    models.put(served("three", "robot"))
    after = models.catalog_response(before.catalog_etag)
    assert [model.model_id for model in after.models] == ["one", "two", "three"]
    assert [rig.rig_id for rig in after.rigs] == ["fake", "robot"]
    assert after.limits == before.limits
    assert not models.catalog_response(after.catalog_etag).models


def test_catalogue_with_an_unchanged_etag_still_tells_the_free_share() -> None:
    models = ModelRegistry(served("one"))
    first = models.catalog_response("")
    etag, told = first.catalog_etag, first.free_share
    models.find("").engine.free_share = 0.125  # type: ignore[misc]
    known = models.catalog_response(etag)
    assert (told, known.free_share) == (0.25, 0.125)
    assert not known.models
    assert models.catalog_response("").catalog_etag == etag


def test_removed_model_leaves_the_catalogue_and_the_next_becomes_the_default() -> None:
    first, second = served("one"), served("two", "robot")
    models = ModelRegistry(first)
    models.put(second)
    models.remove(first)
    assert (models.find(""), len(models)) == (second, 1)
    assert [rig.rig_id for rig in models.catalog_response("").rigs] == ["robot"]


def test_removing_a_replaced_model_keeps_its_replacement() -> None:
    old, new = served("one"), served("one")
    models = ModelRegistry(old)
    models.put(served("two"))
    models.put(new)
    models.remove(old)
    assert models.find("") is models.find("one") is new
