"""The admin service: what operators may ask of the models of a running server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import grpc
import grpc.aio
from google.protobuf.message import Message

from motiongen.v1 import admin_pb2, admin_pb2_grpc
from motiongen_server.engine.types import Code
from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import Role
from motiongen_server.identity.callers import Callers
from motiongen_server.models.manager import CannotKeep, ModelManager
from motiongen_server.models.registry import LoadedModel, ModelState
from motiongen_server.rpc.issuer_keys import keys_for

MAX_GRACE_S = 3600.0

T = TypeVar("T")


class AdminService(admin_pb2_grpc.MotionAdminServiceServicer):
    """Answers calls by what the manager can do. What was begun goes on when the caller has gone."""

    def __init__(self, manager: ModelManager, load_of: Callable[[str], float], callers: Callers | None = None) -> None:
        """load_of: the share of the machine in use, as a model's engine sees it. callers: who may call."""
        self._callers = callers or Callers()
        self._manager = manager
        self._load_of = load_of
        self._under_way: set[asyncio.Task[Any]] = set()

    async def ListModels(
        self,
        request: admin_pb2.ListModelsRequest,
        context: grpc.aio.ServicerContext[admin_pb2.ListModelsRequest, admin_pb2.ListModelsResponse],
    ) -> admin_pb2.ListModelsResponse:
        """All models, the one that is being loaded last."""
        await self._check_open(context)
        models = [self._status(kept) for kept in self._manager.kept]
        if self._manager.loading is not None:
            models.append(admin_pb2.ModelStatus(source=self._manager.loading, state=admin_pb2.MODEL_STATE_LOADING))
        return admin_pb2.ListModelsResponse(models=models)

    async def LoadModel(
        self,
        request: admin_pb2.LoadModelRequest,
        context: grpc.aio.ServicerContext[admin_pb2.LoadModelRequest, admin_pb2.LoadModelResponse],
    ) -> admin_pb2.LoadModelResponse:
        """One model more."""
        await self._check_open(context)
        if not request.source:
            await context.abort_with_status(_no_field("source", "a model's name, folder or repository"))
        kept = await self._done(self._manager.load(request.source), context)
        return admin_pb2.LoadModelResponse(model=self._status(kept))

    async def UnloadModel(
        self,
        request: admin_pb2.UnloadModelRequest,
        context: grpc.aio.ServicerContext[admin_pb2.UnloadModelRequest, admin_pb2.UnloadModelResponse],
    ) -> admin_pb2.UnloadModelResponse:
        """One model less."""
        await self._check_open(context)
        grace_s = await _grace_s(request, context)
        closed = await self._done(self._manager.unload(request.model_id, grace_s), context)
        return admin_pb2.UnloadModelResponse(closed_sessions=closed)

    async def ReloadModel(
        self,
        request: admin_pb2.ReloadModelRequest,
        context: grpc.aio.ServicerContext[admin_pb2.ReloadModelRequest, admin_pb2.ReloadModelResponse],
    ) -> admin_pb2.ReloadModelResponse:
        """The same model anew."""
        await self._check_open(context)
        grace_s = await _grace_s(request, context)
        kept, closed = await self._done(self._manager.reload(request.model_id, grace_s), context)
        return admin_pb2.ReloadModelResponse(model=self._status(kept), closed_sessions=closed)

    async def _check_open(self, context: grpc.aio.ServicerContext[Any, Any]) -> None:
        metadata = context.invocation_metadata() or ()
        await keys_for(self._callers, metadata)
        try:
            self._callers.identify(metadata, context.auth_context(), Role.ADMIN)
        except StreamRefused as refusal:
            await context.abort_with_status(refusal.status())
        if not self._manager.is_open:
            message = "the server is loading its first models; try again when its health is SERVING"
            await context.abort_with_status(
                StreamRefused(grpc.StatusCode.UNAVAILABLE, "STARTING", message, retry_after_s=1.0).status()
            )

    async def _done(self, work: Coroutine[Any, Any, T], context: grpc.aio.ServicerContext[Any, Any]) -> T:
        """What the work comes to. It is finished also where the caller does not wait for it."""
        task = asyncio.create_task(work)
        self._under_way.add(task)
        task.add_done_callback(self._finished)
        try:
            return await asyncio.shield(task)
        except CannotKeep as error:
            await context.abort_with_status(
                StreamRefused(grpc.StatusCode[error.code.name], error.reason, str(error)).status()
            )
            raise

    def _finished(self, task: asyncio.Task[Any]) -> None:
        self._under_way.discard(task)
        if not task.cancelled():
            task.exception()  # looked at: the caller may be gone

    def _status(self, kept: LoadedModel) -> admin_pb2.ModelStatus:
        failure = kept.engine.failure
        return admin_pb2.ModelStatus(
            model_id=kept.model_id,
            source=kept.source,
            state=int(kept.state),  # type: ignore[arg-type]  # the manager's numbers are the protocol's
            sessions=kept.engine.num_sessions,
            load=self._load_of(kept.model_id),
            message=f"its engine failed: {failure}" if kept.state is ModelState.FAILED else "",
        )


def add_admin(service: AdminService, server: grpc.aio.Server) -> None:
    """Serve it."""
    admin_pb2_grpc.add_MotionAdminServiceServicer_to_server(service, server)


async def _grace_s(request: Message, context: grpc.aio.ServicerContext[Any, Any]) -> float | None:
    """The grace of a request; None where there is none."""
    assert isinstance(request, admin_pb2.UnloadModelRequest | admin_pb2.ReloadModelRequest)
    if not request.model_id:
        await context.abort_with_status(_no_field("model_id", "a model of ListModels"))
    if not request.HasField("grace"):
        return None
    grace_s: float = request.grace.seconds + request.grace.nanos / 1e9
    if not 0 <= grace_s <= MAX_GRACE_S:
        message = f"the grace is {grace_s:g} s; it must be from 0 to {MAX_GRACE_S:g} s"
        await context.abort_with_status(
            StreamRefused(grpc.StatusCode.INVALID_ARGUMENT, "GRACE_OUT_OF_RANGE", message, field="grace").status()
        )
    return grace_s


def _no_field(field: str, allowed: str) -> grpc.Status:
    message = f"{field} is empty; give {allowed}"
    code = grpc.StatusCode[Code.INVALID_ARGUMENT.name]
    return StreamRefused(code, "FIELD_EMPTY", message, field=field).status()
