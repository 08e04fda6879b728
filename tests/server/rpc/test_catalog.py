"""The catalogue: what it says of the model, and its etag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motiongen.v1 import service_pb2
from motiongen_server.engine.types import Guidance
from motiongen_server.rpc.catalog import Catalog, rig_message
from motiongen_server.rpc.limits import Limits
from tests.server.engine.fakes import FACTS


def catalog(limits: Limits | None = None, licence: str = "CC0-1.0") -> Catalog:
    return Catalog(FACTS, limits or Limits(), Guidance(1.5, 2.5), licence, text_encoder="hashed-1", history_frames=16)


def test_catalog_describes_the_model_and_its_rig() -> None:
    response = catalog().response("")
    (model,), (rig,) = response.models, response.rigs
    assert (model.model_id, model.rig_id, rig.rig_id) == (FACTS.model_id, FACTS.rig.rig_id, FACTS.rig.rig_id)
    assert (model.horizon_frames, model.patch_frames) == (FACTS.horizon, FACTS.patch)
    assert (model.min_denoise_steps, model.default_denoise_steps, model.max_denoise_steps) == (2, 4, 10)
    assert model.future_frames == FACTS.max_window_frames - FACTS.horizon - 16
    assert model.num_parameters == 1234
    assert (model.default_guidance.text, model.default_guidance.constraint) == (1.5, 2.5)
    assert (model.licence, model.text_encoder) == ("CC0-1.0", "hashed-1")


def test_limits_message_sets_every_limit() -> None:
    limits = catalog().limits_message
    assert {each.name for each, _ in limits.ListFields()} == set(service_pb2.Limits.DESCRIPTOR.fields_by_name)


def test_known_etag_is_answered_with_the_etag_alone() -> None:
    offered = catalog()
    etag = offered.response("").catalog_etag
    assert etag
    assert offered.response(etag) == service_pb2.GetCatalogResponse(catalog_etag=etag)
    assert offered.response("stale").rigs


def test_etag_changes_only_when_the_content_does() -> None:
    etag = catalog().response("").catalog_etag
    assert catalog().response("").catalog_etag == etag
    assert catalog(Limits(max_prompts=3)).response("").catalog_etag != etag
    assert catalog(licence="MIT").response("").catalog_etag != etag


def test_rig_message_lists_offsets_joint_by_joint() -> None:
    layout = replace(
        FACTS.rig,
        joint_names=("hips", "spine"),
        parents=(-1, 0),
        neutral_offsets=np.array([[0, 0, 0], [1, 2, 3]], np.float32),
    )
    message = rig_message(replace(FACTS, rig=layout))
    assert list(message.parents) == [-1, 0]
    assert list(message.neutral_offsets_m) == [0, 0, 0, 1, 2, 3]
    assert sum(block.width for block in message.blocks) == layout.row_width
