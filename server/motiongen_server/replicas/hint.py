"""RefusedOpen: the answer to an open that only this server cannot serve, with servers that have room for it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

from motiongen_server.engine.types import Outcome

OF_THIS_SERVER = frozenset({"OVERLOADED", "SESSION_LIMIT", "ENGINE_RESTARTING", "MODEL_FAILED"})
"""Reasons that concern this server only. Callers' quotas are not among them: other servers are no way around those."""


class OtherServer(NamedTuple):
    """address: where clients reach it, "" if it does not say. routing_key: by which a proxy routes to it, or ""."""

    address: str
    routing_key: str


@dataclass(frozen=True, slots=True)
class RefusedOpen(Outcome):
    """other_servers: servers with room, in the order in which to ask them."""

    other_servers: tuple[OtherServer, ...] = ()

    @classmethod
    def of(cls, refusal: Outcome, other_servers: tuple[OtherServer, ...]) -> Outcome:
        """The refusal with these servers; unchanged if there are none."""
        if not other_servers:
            return refusal
        said = {each.name: getattr(refusal, each.name) for each in fields(Outcome)}
        return cls(**said, other_servers=other_servers)
