"""RefusedOpen: the answer to an open that is refused for what this server lacks, and which others may have it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

from motiongen_server.engine.types import Outcome

OF_THIS_SERVER = frozenset({"OVERLOADED", "SESSION_LIMIT", "ENGINE_RESTARTING", "MODEL_FAILED"})
"""Reasons that hold for one server. Quotas of who calls are not among them: another server is no way around those."""


class OtherServer(NamedTuple):
    """address: where clients reach it, "" where that is not told. routing_key: by which a proxy leads there, or ""."""

    address: str
    routing_key: str


@dataclass(frozen=True, slots=True)
class RefusedOpen(Outcome):
    """other_servers: those with room, the one to be asked first at the beginning."""

    other_servers: tuple[OtherServer, ...] = ()

    @classmethod
    def of(cls, refusal: Outcome, other_servers: tuple[OtherServer, ...]) -> Outcome:
        """The same refusal with them; as it is where there are none."""
        if not other_servers:
            return refusal
        said = {each.name: getattr(refusal, each.name) for each in fields(Outcome)}
        return cls(**said, other_servers=other_servers)
