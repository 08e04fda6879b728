"""AdminClient: lists, loads and unloads the models of a running server, through its optional admin service."""

from __future__ import annotations

from collections.abc import Awaitable
from dataclasses import dataclass
from typing import TypeVar

import grpc.aio
from google.protobuf.duration_pb2 import Duration

from motiongen.v1 import admin_pb2
from motiongen.v1.admin_pb2_grpc import MotionAdminServiceStub
from motiongen_client.channel import ChannelSettings, Token
from motiongen_client.status import answer_of, error_of
from motiongen_client.types import check_number, check_text

T = TypeVar("T")

_STATE_PREFIX = "MODEL_STATE_"
_LIST_TIMEOUT_S = 10.0
_MOST_GRACE_S = 3600.0
"""The most that a server accepts."""


@dataclass(frozen=True)
class ModelStatus:
    """One model as the server holds it.

    model_id: "" while it is loaded for the first time; source: what it was loaded from; state: loading, serving,
    unloading or failed, or unspecified for a state known only to newer servers; sessions: how many are open; load:
    committed share of the machine, where 1 is all of it; message: why it failed.
    """

    model_id: str
    source: str
    state: str
    sessions: int
    load: float
    message: str


class AdminClient:
    """A connection to a server's admin service. Use it as `async with AdminClient("localhost:50052") as admin`.

    address: that of the server's --admin-listen, host:port or unix:PATH. token: that of a tenant with the role admin,
    if the server authenticates callers. Every call raises NotAllowed if the caller may not make it, EventRefused if the
    server cannot do it (what it serves is then unchanged), ServerUnavailable if no server answers, and StreamLost if
    the client is closed meanwhile.
    """

    def __init__(self, address: str, *, token: Token | None = None) -> None:
        self.address = address
        self._channel = ChannelSettings(address, token=token).open()
        self._stub = MotionAdminServiceStub(self._channel)

    async def list_models(self) -> tuple[ModelStatus, ...]:
        """All models, the default first."""
        call = self._stub.ListModels(admin_pb2.ListModelsRequest(), timeout=_LIST_TIMEOUT_S)
        return tuple(_status(model) for model in (await self._answer(call, "listing models")).models)

    async def load_model(self, source: str) -> ModelStatus:
        """Load another model, named as for the server's --model. Returns when sessions can be opened with it."""
        check_text("source", source)
        call = self._stub.LoadModel(admin_pb2.LoadModelRequest(source=source))
        return _status((await self._answer(call, f"loading {source!r}")).model)

    async def unload_model(self, model_id: str, grace_s: float | None = None) -> int:
        """Unload a model. Returns how many sessions had to be closed.

        grace_s: how long its sessions may continue. None: refused while any session is open. Raises InvalidInput if
        grace_s is out of range.
        """
        check_text("model_id", model_id)
        request = admin_pb2.UnloadModelRequest(model_id=model_id, grace=_duration(grace_s))
        return (await self._answer(self._stub.UnloadModel(request), f"unloading {model_id!r}")).closed_sessions

    async def reload_model(self, model_id: str, grace_s: float | None = None) -> tuple[ModelStatus, int]:
        """Load a model again, in place of the old one. Returns its status and how many sessions had to be closed.

        grace_s: as for `unload_model`, counted from when the new model is served.
        """
        check_text("model_id", model_id)
        request = admin_pb2.ReloadModelRequest(model_id=model_id, grace=_duration(grace_s))
        answer = await self._answer(self._stub.ReloadModel(request), f"reloading {model_id!r}")
        return _status(answer.model), answer.closed_sessions

    async def _answer(self, call: Awaitable[T], event: str) -> T:
        try:
            return await answer_of(call)
        except grpc.aio.AioRpcError as failure:
            raise error_of(failure, event, self.address) from None

    async def close(self) -> None:
        """End the connection. The server completes what was asked of it."""
        await self._channel.close(None)

    async def __aenter__(self) -> AdminClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


def _status(message: admin_pb2.ModelStatus) -> ModelStatus:
    known = message.state in admin_pb2.ModelState.values()
    name = admin_pb2.ModelState.Name(message.state) if known else "UNSPECIFIED"  # a newer server's state
    state = name.removeprefix(_STATE_PREFIX).lower()
    return ModelStatus(message.model_id, message.source, state, message.sessions, message.load, message.message)


def _duration(seconds: float | None) -> Duration | None:
    if seconds is None:
        return None
    allowed = f"seconds from 0 to {_MOST_GRACE_S:g}, or None"
    check_number("grace_s", seconds, allowed, lambda s: 0 <= s <= _MOST_GRACE_S)
    duration = Duration()
    duration.FromMilliseconds(round(1000 * seconds))
    return duration
