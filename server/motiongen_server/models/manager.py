"""ModelManager: holds the engines of all models; loads, unloads and reloads models while others are served."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Protocol

from motiongen_server.background import start_in_background
from motiongen_server.engine.engine_port import EnginePort, ModelLost
from motiongen_server.engine.types import Code, EventRefused
from motiongen_server.engine_process.connection import EngineLost, LoadFailed
from motiongen_server.models.registry import LoadedModel, ModelRegistry, ModelState
from motiongen_server.ops.memory import settle_again
from motiongen_server.rpc.errors.events import model_failed, model_reloading
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)

LOOK_EVERY_S = 0.05
CLOSE_S = 2.0
"""How long to wait for sessions that are told to close, and for an engine that is told to end."""


class CannotKeep(Exception):
    """Why a model is not loaded or unloaded; served models are not affected. reason: a word for programs."""

    def __init__(self, code: Code, reason: str, message: str) -> None:
        super().__init__(message)
        self.code = code
        self.reason = reason


class Closer(Protocol):
    """Closes the sessions of a model; the service does."""

    def close_model(self, model: LoadedModel) -> int: ...


class ModelManager:
    """The engines of all models: watches, drains and stops them together. Its coroutines run on the event loop only.

    One model is loaded at a time. If that fails, CannotKeep is raised and everything else stays as it was.
    """

    def __init__(self, make: Callable[[str], Awaitable[LoadedModel]], forget: Callable[[LoadedModel], None]) -> None:
        """make: loads a model from a source; raises SettingError. forget: called with a model that is gone for good."""
        self._make = make
        self._forget = forget
        self._kept: list[LoadedModel] = []
        self._loading: str | None = None
        self._loading_since = 0.0
        self._models: ModelRegistry | None = None
        self._closer: Closer | None = None
        self._is_draining = False

    # ---- the models -------------------------------------------------------------------------------------------------

    def adopt(self, model: LoadedModel) -> None:
        """Hold and offer a model that was loaded at startup."""
        self._kept.append(model)
        if self._models is None:
            self._models = ModelRegistry(model)
        else:
            self._models.put(model)

    def open(self, closer: Closer) -> None:
        """Startup is over. closer: closes the sessions of a model that is unloaded."""
        self._closer = closer

    def __contains__(self, model_id: str) -> bool:
        return any(kept.model_id == model_id for kept in self._kept)

    @property
    def is_open(self) -> bool:
        """Whether startup is over."""
        return self._closer is not None

    @property
    def models(self) -> ModelRegistry:
        """The models that are offered, at least one."""
        assert self._models is not None
        return self._models

    @property
    def kept(self) -> tuple[LoadedModel, ...]:
        """All models that are held, the default first."""
        return tuple(self._kept)

    @property
    def loading(self) -> str | None:
        """The source of the model that is being loaded, if one is."""
        return self._loading

    async def load(self, source: str) -> LoadedModel:
        """Load one more model, and offer it. Raises CannotKeep."""
        kept = await self._load(source)
        if kept.model_id in self:
            await self._end(kept.engine)
            message = f"{kept.model_id} is already loaded; use reload to load it again"
            raise CannotKeep(Code.ALREADY_EXISTS, "MODEL_LOADED", message)
        self._kept.append(kept)
        self.models.put(kept)
        settle_again()
        _log.info("%s is served now, from %r", kept.model_id, source)
        return kept

    async def unload(self, model_id: str, grace_s: float | None) -> int:
        """Unload a model; returns how many sessions had to be closed. Raises CannotKeep.

        grace_s: how long its sessions may continue; None: refuse if there are any.
        """
        kept = self._find(model_id)
        others = [other for other in self._kept if other is not kept and other.state is ModelState.SERVING]
        if not others:
            message = f"{model_id} is the only model that is served; load another one first"
            raise CannotKeep(Code.FAILED_PRECONDITION, "LAST_MODEL", message)
        self._check_free(kept, grace_s)
        self.models.remove(kept)
        closed = await self._retire(kept, grace_s)
        self._forget(kept)
        del kept
        settle_again()
        _log.info("%s has been unloaded, %d sessions were closed", model_id, closed)
        return closed

    async def reload(self, model_id: str, grace_s: float | None) -> tuple[LoadedModel, int]:
        """Load a model again and replace the old one with it; returns how many sessions had to be closed.

        grace_s: as for `unload`, counted from then on. Raises CannotKeep; the old one is then served as before.
        """
        old = self._find(model_id)
        self._check_free(old, grace_s)
        before, reloading = old.refusal, model_reloading(model_id)
        if grace_s is None:
            old.refusal = reloading
        try:
            kept = await self._load(old.source)
            if kept.model_id != model_id:
                await self._end(kept.engine)
                if kept.model_id not in self:
                    self._forget(kept)
                message = f"{old.source!r} now holds {kept.model_id}, not {model_id}; use load for that"
                raise CannotKeep(Code.FAILED_PRECONDITION, "ANOTHER_MODEL", message)
        except CannotKeep:
            if old.refusal is reloading:  # else its engine has failed since
                old.refusal = before if old.state is ModelState.FAILED else None  # it may serve again meanwhile
            raise
        self._kept[self._kept.index(old)] = kept
        self.models.put(kept)
        self._kept.append(old)
        closed = await self._retire(old, grace_s)
        del old
        settle_again()
        _log.info("%s has been loaded anew, %d sessions were closed", model_id, closed)
        return kept, closed

    def _find(self, model_id: str) -> LoadedModel:
        """The model with that id. Raises CannotKeep if there is none, or it is being loaded or unloaded."""
        for kept in self._kept:
            if kept.model_id == model_id:
                if kept.state is ModelState.UNLOADING or self._loading == kept.source:
                    message = f"{model_id} is being loaded or unloaded; wait for the end of that"
                    raise CannotKeep(Code.FAILED_PRECONDITION, "MODEL_BUSY", message)
                return kept
        known = ", ".join(kept.model_id for kept in self._kept)
        raise CannotKeep(Code.NOT_FOUND, "UNKNOWN_MODEL", f"no model {model_id[:80]!r} is loaded; there are {known}")

    @staticmethod
    def _check_free(kept: LoadedModel, grace_s: float | None) -> None:
        if grace_s is None and kept.engine.num_sessions:
            message = (
                f"{kept.model_id} has open sessions ({kept.engine.num_sessions}); give a grace, after which they are "
                "closed"
            )
            raise CannotKeep(Code.FAILED_PRECONDITION, "SESSIONS_OPEN", message)

    async def _load(self, source: str) -> LoadedModel:
        if self._loading is not None:
            loading_s = time.monotonic() - self._loading_since
            message = (
                f"{self._loading!r} has been loading for {loading_s:.0f} s, and one model is loaded at a time; if a "
                "disk or a device hangs, end the engine processes, which are started anew without it"
            )
            raise CannotKeep(Code.UNAVAILABLE, "LOADING", message)
        self._loading, self._loading_since = source, time.monotonic()
        _log.info("loading %r", source)
        try:
            made = await self._make(source)
            if self._is_draining:  # the drain began meanwhile, and its sessions would not end in time
                made.engine.drain()
            return made
        except SettingError as error:
            raise CannotKeep(Code.FAILED_PRECONDITION, "CANNOT_LOAD", str(error)) from error
        except Exception as error:
            if self._is_draining:
                _log.info("loading %r was broken off", source)
                message = f"{source!r} is not loaded any more: the server is going away"
                raise CannotKeep(Code.UNAVAILABLE, "DRAINING", message) from error
            if isinstance(error, EngineLost) and not isinstance(error, LoadFailed):
                message = f"{source!r} is not loaded: {error}; try again once all engine processes serve"
                _log.error("%s", message)
                raise CannotKeep(Code.UNAVAILABLE, "ENGINE_LOST", message) from error
            _log.exception("loading %r failed", source)
            raise CannotKeep(Code.INTERNAL, "CANNOT_LOAD", f"loading {source!r} failed; the log says why") from error
        finally:
            self._loading = None

    async def _retire(self, kept: LoadedModel, grace_s: float | None) -> int:
        """Wait for the sessions of a model that is no longer offered, close those that are left, and end its engine."""
        assert self._closer is not None
        kept.state = ModelState.UNLOADING
        await self._until_empty(kept.engine, grace_s or 0.0)
        closed = self._closer.close_model(kept)
        await self._until_empty(kept.engine, CLOSE_S)
        await self._end(kept.engine)
        self._kept.remove(kept)
        return closed

    @staticmethod
    async def _until_empty(engine: EnginePort, patience_s: float) -> None:
        ends_at = time.monotonic() + patience_s
        while engine.num_sessions and time.monotonic() < ends_at:  # noqa: ASYNC110  engines run on other threads
            await asyncio.sleep(LOOK_EVERY_S)

    @staticmethod
    async def _end(engine: EnginePort) -> None:
        engine.stop()
        await start_in_background(lambda: engine.join(CLOSE_S), "unloading")

    # ---- all engines as one -----------------------------------------------------------------------------------------

    def look_after(self) -> None:
        """Update which models have failed, and which serve again."""
        for kept in self._kept:
            failure = kept.engine.failure
            if kept.state is ModelState.SERVING and failure is not None:
                kept.state = ModelState.FAILED
                kept.refusal = _refusal_of(kept, failure)
                _log.error("%s", kept.refusal)
            elif kept.state is ModelState.FAILED:
                if kept.refusal is not None and kept.refusal.reason == "MODEL_FAILED":  # else it is being reloaded
                    kept.refusal = None if failure is None else _refusal_of(kept, failure)
                if failure is None:
                    kept.state = ModelState.SERVING
                    _log.info("%s is served again", kept.model_id)

    @property
    def failure(self) -> BaseException | None:
        """Why nothing can be served any more: the engines of all models have failed."""
        failures = [kept.engine.failure for kept in self._kept if kept.state is not ModelState.UNLOADING]
        return failures[0] if failures and all(failures) else None

    @property
    def heartbeat_at(self) -> float:
        """The oldest heartbeat of models that an engine serves, in monotonic seconds; of those that have not failed if
        none is served.

        A model that is being loaded again keeps the server from nothing that others are served for, however long that
        takes. Models that are being unloaded are left out: at their end they send no more heartbeats.
        """
        held = [kept.engine for kept in self._kept if kept.state is not ModelState.UNLOADING]
        working = [engine for engine in held if engine.failure is None]
        served = [engine for engine in working if engine.num_engines]
        return min((engine.heartbeat_at for engine in served or working), default=0.0)

    def drain(self) -> None:
        """Admit no new sessions. A model that is being loaded will not be finished."""
        self._is_draining = True
        for kept in self._kept:
            kept.engine.drain()

    async def stop(self) -> None:
        """Close every session, and end all engines."""
        await asyncio.gather(*(self._end(kept.engine) for kept in self._kept))


def _refusal_of(kept: LoadedModel, failure: BaseException) -> EventRefused:
    """What clients are told about a model that has failed; the details are only logged."""
    return model_failed(kept.model_id, failure.told if isinstance(failure, ModelLost) else "its engine has failed")
