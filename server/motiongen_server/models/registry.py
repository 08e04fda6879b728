"""ModelRegistry: which of the models that are served an OpenSession gets, and what clients are told of them all."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from motiongen.v1 import service_pb2
from motiongen_server.engine.engine_port import EnginePort
from motiongen_server.engine.types import Owner
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.errors.events import unknown_model
from motiongen_server.rpc.limits import Limits
from motiongen_server.text.prompts import PromptEncoder


class ModelState(IntEnum):
    """What a model that was loaded is doing; the numbers are those of the protocol."""

    SERVING = 2
    UNLOADING = 3
    FAILED = 4


@dataclass(eq=False)
class LoadedModel:
    """One model: its engine, and what its sessions are served with.

    source: what it was loaded from, as it was asked for. refusal: what new sessions are told while it takes none.
    """

    source: str
    engine: EnginePort
    prompts: PromptEncoder
    catalog: Catalog
    licence: str = ""
    state: ModelState = ModelState.SERVING
    refusal: EventRefused | None = None

    @property
    def model_id(self) -> str:
        """The name that clients ask for it by."""
        return self.catalog.facts.model_id

    def steps_hz(self, steps: int) -> float:
        """Denoising steps a second that a session takes to play on, with so many a window."""
        return steps * self.catalog.facts.fps / self.catalog.facts.horizon


class ModelRegistry:
    """The models that sessions can be opened with, the default first; never empty. Used from the event loop only."""

    def __init__(self, first: LoadedModel) -> None:
        self._served = {first.model_id: first}
        self.is_gateway_full: Callable[[], bool] = lambda: False  # then no model has room, whatever its engines say
        self._response = _catalog_response(self._served.values())

    def __iter__(self) -> Iterator[LoadedModel]:
        return iter(tuple(self._served.values()))

    def __len__(self) -> int:
        return len(self._served)

    def __contains__(self, model_id: str) -> bool:
        return model_id in self._served

    @property
    def default(self) -> LoadedModel:
        """What a session gets that names none."""
        return next(iter(self))

    @property
    def limits(self) -> Limits:
        """What a client must keep to, whichever models it uses."""
        return self.default.catalog.limits

    @property
    def limits_message(self) -> service_pb2.Limits:
        """The same as a message."""
        return self.default.catalog.limits_message

    def named(self, model_id: str) -> LoadedModel:
        """The model of that name, the default for an empty one, though it may take no sessions. Raises EventRefused."""
        served = self._served.get(model_id) if model_id else self.default
        if served is None:
            raise unknown_model(model_id, self._served)
        return served

    def find(self, model_id: str) -> LoadedModel:
        """The same. Raises EventRefused also where no session can be opened with it."""
        served = self.named(model_id)
        if served.refusal is not None:
            raise served.refusal
        return served

    def put(self, served: LoadedModel) -> None:
        """Offer a model, in the place of the one of the same name if there is one, else as the last."""
        self._served[served.model_id] = served
        self._response = _catalog_response(self._served.values())

    def remove(self, served: LoadedModel) -> None:
        """Offer a model no more, unless another has its place already. The next one is the default if it was."""
        if self._served.get(served.model_id) is served:
            del self._served[served.model_id]
            self._response = _catalog_response(self._served.values())

    def note_owner(self, owner: Owner) -> None:
        """Tell all engines what an owner may have from now on."""
        for each in self:
            each.engine.note_owner(owner)

    @property
    def free_share(self) -> float:
        """The share of the default model's capacity that is left to new sessions, 0 to 1."""
        return self._free_share_of(self.default)

    @property
    def free_shares(self) -> dict[str, float]:
        """The same of each model, by its name. From any thread; 0 of those that take no sessions."""
        return {each.model_id: 0.0 if each.refusal else self._free_share_of(each) for each in self}

    @property
    def num_engines(self) -> dict[str, int]:
        """How many engine processes serve each model at this moment, by its name. From any thread."""
        return {each.model_id: each.engine.num_engines for each in self}

    def _free_share_of(self, model: LoadedModel) -> float:
        return 0.0 if self.is_gateway_full() else model.engine.free_share

    def catalog_response(self, known_etag: str) -> service_pb2.GetCatalogResponse:
        """The catalogue, or its etag alone for a client that holds it already; with what is free at this moment."""
        if known_etag == self._response.catalog_etag:
            return service_pb2.GetCatalogResponse(catalog_etag=known_etag, free_share=self.free_share)
        self._response.free_share = self.free_share  # no part of what the etag stands for
        return self._response


def _catalog_response(served: Iterable[LoadedModel]) -> service_pb2.GetCatalogResponse:
    """The catalogues of single models as one."""
    whole = service_pb2.GetCatalogResponse()
    for number, each in enumerate(served):
        one = each.catalog.response("")
        if not number:
            whole.limits.CopyFrom(one.limits)
        whole.models.extend(one.models)
        known = {rig.rig_id for rig in whole.rigs}
        whole.rigs.extend(rig for rig in one.rigs if rig.rig_id not in known)
    whole.catalog_etag = hashlib.sha256(whole.SerializeToString(deterministic=True)).hexdigest()[:16]
    return whole
