"""The admin service: operators list, load, unload and reload the models of a running server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import grpc
import grpc.aio

from motiongen.v1 import admin_pb2
from motiongen_server.engine.engine_port import ModelLost
from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import Role
from motiongen_server.identity.callers import Callers
from motiongen_server.models.manager import CannotKeep, ModelManager
from motiongen_server.models.registry import LoadedModel, ModelState
from motiongen_server.rpc.calls.context import CallContext, unary_method
from motiongen_server.rpc.calls.issuer_keys import keys_for
from motiongen_server.rpc.calls.requests import Requests, parsed_as
from motiongen_server.rpc.grpc_server import serve_methods

MAX_GRACE_S = 3600.0
SERVICE_NAME = admin_pb2.DESCRIPTOR.services_by_name["MotionAdminService"].full_name

T = TypeVar("T")


class AdminService:
    """Has the manager do what callers ask. Work that has begun continues even if the caller disconnects."""

    def __init__(self, manager: ModelManager, load_of: Callable[[str], float], callers: Callers | None = None) -> None:
        """load_of: returns the committed share of the machine, as a model's engines see it. callers: who may call."""
        self._callers = callers or Callers()
        self._manager = manager
        self._load_of = load_of
        self._under_way: set[asyncio.Task[Any]] = set()

    async def ListModels(self, call: CallContext) -> admin_pb2.ListModelsResponse:
        """All models; one that is being loaded comes last. Raises StreamRefused."""
        await self._check_open(call)
        parsed_as(admin_pb2.ListModelsRequest, await call.request())
        models = [self._status(kept) for kept in self._manager.kept]
        if self._manager.loading is not None:
            models.append(admin_pb2.ModelStatus(source=self._manager.loading, state=admin_pb2.MODEL_STATE_LOADING))
        return admin_pb2.ListModelsResponse(models=models)

    async def LoadModel(self, call: CallContext) -> admin_pb2.LoadModelResponse:
        """Load one more model. Raises StreamRefused."""
        await self._check_open(call)
        request = parsed_as(admin_pb2.LoadModelRequest, await call.request())
        if not request.source:
            raise _no_field("source", "a model's name, folder or repository")
        kept = await self._done(self._manager.load(request.source))
        return admin_pb2.LoadModelResponse(model=self._status(kept))

    async def UnloadModel(self, call: CallContext) -> admin_pb2.UnloadModelResponse:
        """Unload a model. Raises StreamRefused."""
        await self._check_open(call)
        request = parsed_as(admin_pb2.UnloadModelRequest, await call.request())
        grace_s = _grace_s(request)
        closed = await self._done(self._manager.unload(request.model_id, grace_s))
        return admin_pb2.UnloadModelResponse(closed_sessions=closed)

    async def ReloadModel(self, call: CallContext) -> admin_pb2.ReloadModelResponse:
        """Load a model again and replace the old one. Raises StreamRefused."""
        await self._check_open(call)
        request = parsed_as(admin_pb2.ReloadModelRequest, await call.request())
        grace_s = _grace_s(request)
        kept, closed = await self._done(self._manager.reload(request.model_id, grace_s))
        return admin_pb2.ReloadModelResponse(model=self._status(kept), closed_sessions=closed)

    async def _check_open(self, call: CallContext) -> None:
        metadata = call.invocation_metadata() or ()
        await keys_for(self._callers, metadata)
        self._callers.identify(metadata, call.auth_context(), Role.ADMIN)
        if not self._manager.is_open:
            message = "the server is loading its first models; try again when its health is SERVING"
            raise StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", message, retry_after_s=1.0)

    async def _done(self, work: Coroutine[Any, Any, T]) -> T:
        """The result of `work`, which is finished even if the caller does not wait for it."""
        task = asyncio.create_task(work)
        self._under_way.add(task)
        task.add_done_callback(self._finished)
        try:
            return await asyncio.shield(task)
        except CannotKeep as error:
            raise StreamRefused(grpc.StatusCode[error.code.name], error.reason, str(error)) from error

    def _finished(self, task: asyncio.Task[Any]) -> None:
        self._under_way.discard(task)
        if not task.cancelled():
            task.exception()  # retrieved: the caller may be gone

    def _status(self, kept: LoadedModel) -> admin_pb2.ModelStatus:
        failure = kept.engine.failure if kept.state is ModelState.FAILED else None
        return admin_pb2.ModelStatus(
            model_id=kept.model_id,
            source=kept.source,
            state=int(kept.state),  # type: ignore[arg-type]  # the manager's numbers are the protocol's
            sessions=kept.engine.num_sessions,
            load=self._load_of(kept.model_id),
            message="" if failure is None else _why(failure),
        )


def add_admin(service: AdminService, server: grpc.aio.Server) -> None:
    """Register the service with a server."""
    requests = Requests()
    methods = (service.ListModels, service.LoadModel, service.UnloadModel, service.ReloadModel)
    handlers = {method.__name__: unary_method(method, requests) for method in methods}
    serve_methods(server, SERVICE_NAME, handlers)


def _why(failure: BaseException) -> str:
    return str(failure) if isinstance(failure, ModelLost) else f"its engine failed: {failure}"


def _grace_s(request: admin_pb2.UnloadModelRequest | admin_pb2.ReloadModelRequest) -> float | None:
    """The grace period of a request; None if it has none. Raises StreamRefused."""
    if not request.model_id:
        raise _no_field("model_id", "a model of ListModels")
    if not request.HasField("grace"):
        return None
    grace_s: float = request.grace.seconds + request.grace.nanos / 1e9
    if not 0 <= grace_s <= MAX_GRACE_S:
        message = f"the grace is {grace_s:g} s; it must be from 0 to {MAX_GRACE_S:g} s"
        raise StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "GRACE_OUT_OF_RANGE", message, field="grace")
    return grace_s


def _no_field(field: str, allowed: str) -> StreamRefused:
    message = f"{field} is empty; give {allowed}"
    return StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "FIELD_EMPTY", message, field=field)
