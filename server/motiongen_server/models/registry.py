"""ModelRegistry: the models that are offered: finds the one that a session asks for, and makes the catalogue of all."""

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
    """The state of a loaded model; the numbers are those of the protocol."""

    SERVING = 2
    UNLOADING = 3
    FAILED = 4


@dataclass(eq=False)
class LoadedModel:
    """One model: its engine, and what its sessions need.

    source: what it was loaded from, as the operator named it. refusal: the answer to new sessions while it takes none.
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
        """The name by which clients ask for it."""
        return self.catalog.facts.model_id

    def steps_hz(self, steps: int) -> float:
        """Denoising steps a second that a session needs to keep playing. steps: for each window."""
        return steps * self.catalog.facts.fps / self.catalog.facts.horizon


class ModelRegistry:
    """The models that sessions can be opened with, the default first; never empty. Used from the event loop only."""

    def __init__(self, first: LoadedModel) -> None:
        self._served = {first.model_id: first}
        self.is_gateway_full: Callable[[], bool] = lambda: False  # if so, no model has room
        self._response = _catalog_response(self._served.values())

    def __iter__(self) -> Iterator[LoadedModel]:
        return iter(tuple(self._served.values()))

    def __len__(self) -> int:
        return len(self._served)

    def __contains__(self, model_id: str) -> bool:
        return model_id in self._served

    @property
    def default(self) -> LoadedModel:
        """The model of sessions that name none."""
        return next(iter(self))

    @property
    def limits(self) -> Limits:
        """The limits that clients must keep, whichever models they use."""
        return self.default.catalog.limits

    @property
    def limits_message(self) -> service_pb2.Limits:
        """`limits` as a message."""
        return self.default.catalog.limits_message

    def named(self, model_id: str) -> LoadedModel:
        """The model with that name, or the default for ""; it may take no sessions. Raises EventRefused if unknown."""
        served = self._served.get(model_id) if model_id else self.default
        if served is None:
            raise unknown_model(model_id, self._served)
        return served

    def find(self, model_id: str) -> LoadedModel:
        """Like `named`, but also raises EventRefused if no session can be opened with the model."""
        served = self.named(model_id)
        if served.refusal is not None:
            raise served.refusal
        return served

    def put(self, served: LoadedModel) -> None:
        """Offer a model: in place of the one with the same name, if there is one, otherwise as the last."""
        self._served[served.model_id] = served
        self._response = _catalog_response(self._served.values())

    def remove(self, served: LoadedModel) -> None:
        """Stop offering a model, unless another has already replaced it. The next one then is the default if it was."""
        if self._served.get(served.model_id) is served:
            del self._served[served.model_id]
            self._response = _catalog_response(self._served.values())

    def note_owner(self, owner: Owner) -> None:
        """Tell the engines of all models what an owner may have from now on."""
        for each in self:
            each.engine.note_owner(owner)

    @property
    def free_share(self) -> float:
        """The share of the default model's capacity that is left for new sessions, 0 to 1."""
        return self._free_share_of(self.default)

    @property
    def free_shares(self) -> dict[str, float]:
        """The same for each model, by its name; 0 for those that take no sessions. From any thread."""
        return {each.model_id: 0.0 if each.refusal else self._free_share_of(each) for each in self}

    @property
    def num_engines(self) -> dict[str, int]:
        """How many engine processes serve each model at this moment, by its name. From any thread."""
        return {each.model_id: each.engine.num_engines for each in self}

    def _free_share_of(self, model: LoadedModel) -> float:
        return 0.0 if self.is_gateway_full() else model.engine.free_share

    def catalog_response(self, known_etag: str) -> service_pb2.GetCatalogResponse:
        """The catalogue, or only its etag for a client that already has it; with the current `free_share`."""
        if known_etag == self._response.catalog_etag:
            return service_pb2.GetCatalogResponse(catalog_etag=known_etag, free_share=self.free_share)
        self._response.free_share = self.free_share  # the etag does not cover it
        return self._response


def _catalog_response(served: Iterable[LoadedModel]) -> service_pb2.GetCatalogResponse:
    """Merges the catalogues of the models into one."""
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
