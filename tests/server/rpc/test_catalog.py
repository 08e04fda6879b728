"""The catalogue: what it says of the model, and its etag."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from google.protobuf.duration_pb2 import Duration

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
    assert (model.default_history_frames, model.max_history_frames) == (16, FACTS.max_history)
    assert (model.num_parameters, model.text_width) == (1234, FACTS.embedding_dim)
    assert [(block.name, block.width) for block in model.outputs] == [(each.name, each.width) for each in FACTS.outputs]
    assert (model.default_guidance.text, model.default_guidance.constraint) == (1.5, 2.5)
    assert (model.licence, model.text_encoder) == ("CC0-1.0", "hashed-1")


def test_catalog_tells_the_value_of_every_limit() -> None:
    limits = Limits(**{each.name: number for number, each in enumerate(fields(Limits), 101)})  # type: ignore[arg-type]
    limits = replace(limits, resume_grace_s=2.5)
    message = catalog(limits).limits_message
    of_another_name = {
        "max_coordinate_m": 10_000.0,
        "max_guidance": 10.0,
        "max_speed_mps": 10.0,
        "max_events_per_second": limits.events_per_second,
        "max_stream_events_per_second": limits.stream_events_per_second,
        "resume_grace": Duration(seconds=2, nanos=500_000_000),
    }
    names = service_pb2.Limits.DESCRIPTOR.fields_by_name
    same = {name: getattr(limits, name) for name in names if name not in of_another_name}
    assert {name: getattr(message, name) for name in names} == same | of_another_name


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
