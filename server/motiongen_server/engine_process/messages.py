"""What crosses between gateway and engine process: every message, and the two codecs, one for each direction.

Times are seconds of the machine's monotonic clock, which both processes read; `clock_at` proves it at the start.
"""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.config import ServerConfig
from motiongen_server.engine.scheduling.report import StepReport
from motiongen_server.engine.types import Close, Event, ModelFacts, Output
from motiongen_server.engine_process.codec import Codec
from motiongen_server.rpc.abilities import Abilities


@dataclass(frozen=True, slots=True)
class Greeting:
    """The engine process's first message. schema: of its codecs. Every version of this code can read it."""

    schema: str
    clock_at: float


# ---- gateway -> engine ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Begin:
    """Load the model: the first message on each of the two ways in."""

    config: ServerConfig


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """Events in order. They are numbered from the first one of the process; this is the number of the first here."""

    first_number: int
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class CloseAhead:
    """End a session ahead of the events that still wait: its Open is number `opened`, its last event number `last`."""

    close: Close
    opened: int
    last: int


@dataclass(frozen=True, slots=True)
class Stop:
    """Finish the windows that run, close every session as DRAINED, and end."""


# ---- engine -> gateway ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Joined:
    """All ways are connected; loading begins."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The model is loaded and warm. threads: of the model, on the processor. abilities: what it was trained for."""

    facts: ModelFacts
    licence: str
    threads: int
    abilities: Abilities


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    """What the engine delivered at once, in order."""

    outputs: tuple[Output, ...]


@dataclass(frozen=True, slots=True)
class Pulse:
    """The loop goes round: when it last did, and what the steps since the last Pulse did."""

    heartbeat_at: float
    reports: tuple[StepReport, ...]


@dataclass(frozen=True, slots=True)
class Ended:
    """The last message. error: why, empty after Stop. is_setting: whether the settings are at fault."""

    error: str
    is_setting: bool = False


ToEngine = Begin | Events | CloseAhead | Stop
ToGateway = Joined | Ready | Outputs | Pulse | Ended

TO_ENGINE: Codec[ToEngine] = Codec(Begin, Events, CloseAhead, Stop)
TO_GATEWAY: Codec[ToGateway] = Codec(Joined, Ready, Outputs, Pulse, Ended, writable=False)
GREETING: Codec[Greeting] = Codec(Greeting)
SCHEMA = f"{TO_ENGINE.schema}-{TO_GATEWAY.schema}"
