"""Fetching a server's catalogue again, since models are loaded and unloaded, and looking up models in it."""

from __future__ import annotations

import grpc.aio

from motiongen.v1 import service_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_client import convert
from motiongen_client.errors import ServerUnavailable
from motiongen_client.status import MOST_TIMEOUT_S, answer_of
from motiongen_client.types import Catalog, Model, SessionOptions


async def newest_catalog(stub: MotionServiceStub, held: Catalog, address: str, timeout_s: float) -> Catalog:
    """The server's current catalogue; `held` if unchanged. Raises ServerUnavailable or ProtocolViolation."""
    request = service_pb2.GetCatalogRequest(catalog_etag=held.etag)
    try:
        response = await answer_of(stub.GetCatalog(request, timeout=min(timeout_s, MOST_TIMEOUT_S)))
    except grpc.aio.AioRpcError as error:
        raise ServerUnavailable(address, f"{error.code().name}, {error.details()}") from None
    is_held = response.catalog_etag == held.etag and not response.models
    return held if is_held else convert.catalog(response)


def has_model(catalog: Catalog, options: SessionOptions) -> bool:
    """Whether a catalogue has the model of a session: the one it names, or any if it names none."""
    return bool(catalog.models) and options.model_id in ("", *(model.model_id for model in catalog.models))


def model_of(catalog: Catalog, options: SessionOptions) -> Model:
    """The model that a session names, or the default. Raises UnknownName, also if the server has no model."""
    if catalog.models and not options.model_id:
        return catalog.models[0]
    return catalog.model(options.model_id)
