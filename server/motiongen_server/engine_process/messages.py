"""The messages between gateway and engine process, and their two codecs, one for each direction.

A model that an engine process holds is identified by the number of its slot. Times are seconds of the machine's
monotonic clock, which both processes read; `clock_at` verifies that at the start.
"""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import Close, Event, Float32Array, ModelFacts, Output, Owner, StepsOf
from motiongen_server.engine.types.report import StepReport
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
    """The first message on each of the two sockets to the engine process.

    kind: of the device, cpu or cuda. threads: on the CPU. engines: the number of engine processes on devices of this
    kind, without spare ones.
    """

    config: ServerConfig
    kind: str
    threads: int
    engines: int


@dataclass(frozen=True, slots=True)
class Load:
    """Load a model into a new slot; answered with Ready or Unloaded. It is sent ahead of events."""

    slot: int
    source: str


@dataclass(frozen=True, slots=True)
class Unload:
    """Finish the slot's running windows, close its sessions as DRAINED, and free it; answered with Unloaded."""

    slot: int


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """Events of a slot, in order. They are numbered from 1 in each slot; first_number: that of the first one here."""

    slot: int
    first_number: int
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class CloseAhead:
    """End a session ahead of waiting events. opened, last: the numbers of the session's Open and of its last event."""

    slot: int
    close: Close
    opened: int
    last: int


@dataclass(frozen=True, slots=True)
class LoadEncoder:
    """Load the configured text encoder, for models that take vectors of this width; answered with EncoderReady."""

    width: int


@dataclass(frozen=True, slots=True)
class EncodeTexts:
    """Encode prompts; answered with Encoded of the same number."""

    number: int
    texts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StepsElsewhere:
    """The steps that another engine did for owners with a quota. slot: that engine's; 0: of another engine process."""

    slot: int
    taken: StepsOf


@dataclass(frozen=True, slots=True)
class OwnerChanged:
    """What an owner may have from now on, including for its open sessions."""

    slot: int
    owner: Owner


@dataclass(frozen=True, slots=True)
class Stop:
    """Unload every slot, and end."""


# ---- engine -> gateway ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Joined:
    """All sockets are connected."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The model of a slot is loaded, warm, and takes events. abilities: what it was trained for.

    weights: a short name that differs for other weights.
    """

    slot: int
    facts: ModelFacts
    licence: str
    abilities: Abilities
    weights: str = ""


@dataclass(frozen=True, slots=True)
class Unloaded:
    """The last message of a slot. error: why its model could not be loaded. is_setting: a setting is the cause."""

    slot: int
    error: str = ""
    is_setting: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    """What the engine of a slot delivered in one call, in order."""

    slot: int
    outputs: tuple[Output, ...]


@dataclass(frozen=True, slots=True)
class Pulse:
    """A slot's engine is alive. heartbeat_at: when its loop last ran. reports: on the steps since the last Pulse."""

    slot: int
    heartbeat_at: float
    reports: tuple[StepReport, ...]


@dataclass(frozen=True, slots=True)
class EncoderReady:
    """The text encoder is loaded; if not, error says why."""

    identity: str
    width: int
    error: str


@dataclass(frozen=True, slots=True, eq=False)
class Encoded:
    """vectors: (texts, width); without rows if encoding failed, and then error says why."""

    number: int
    vectors: Float32Array
    error: str


@dataclass(frozen=True, slots=True)
class Ended:
    """The last message of an engine process. error: why it ends; empty after Stop."""

    error: str


ToEngine = (
    Begin | Load | Unload | Events | CloseAhead | LoadEncoder | EncodeTexts | StepsElsewhere | OwnerChanged | Stop
)
ToGateway = Joined | Ready | Unloaded | Outputs | Pulse | EncoderReady | Encoded | Ended

TO_ENGINE: Codec[ToEngine] = Codec(
    Begin, Load, Unload, Events, CloseAhead, LoadEncoder, EncodeTexts, StepsElsewhere, OwnerChanged, Stop
)
TO_GATEWAY: Codec[ToGateway] = Codec(
    Joined, Ready, Unloaded, Outputs, Pulse, EncoderReady, Encoded, Ended, writable=False
)
GREETING: Codec[Greeting] = Codec(Greeting)
SCHEMA = f"{TO_ENGINE.schema}-{TO_GATEWAY.schema}"
