"""A session's key, and the enums that the protocol and the engine share."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple


class SessionKey(NamedTuple):
    """One session's address: the stream that carries it, and the client's handle for it on that stream.

    The service may reuse a key once the engine has delivered `Closed` for it: nothing of the old session can reach the
    new.
    """

    stream: int
    handle: int


class Priority(IntEnum):
    """The class of a session, most urgent first; the numbers are those of the protocol."""

    HERO = 1
    NEAR = 2
    CROWD = 3
    BATCH = 4


class PlanCause(IntEnum):
    """Why a plan was made; the numbers are those of the protocol.

    FALLBACK: the server held or corrected a character. RESUME: everything that a client missed while its connection was
    lost. CUT: the character is elsewhere from here on.
    """

    CONTINUE = 1
    EDIT = 2
    FALLBACK = 5
    RESUME = 6
    CUT = 7


class PlayState(IntEnum):
    """Whether the client's clock runs; the numbers are those of the protocol."""

    PLAYING = 1
    PAUSED = 2


class CloseReason(IntEnum):
    """Why a session ended; the numbers are those of the protocol."""

    CLIENT = 1
    IDLE = 2
    SLOW_READER = 3
    DRAINED = 5
    ENGINE_FAULT = 6
    OVERLOAD = 8
    MODEL_UNLOADED = 9
    TAKEN_OVER = 10


class ServiceTier(IntEnum):
    """How much of what it asked for a session gets, most first; the numbers are those of the protocol."""

    FULL = 1
    FEWER_STEPS = 2
    NO_GUIDANCE = 3
    SMALL_MODEL = 4
    HOLD = 5


class Code(IntEnum):
    """The google.rpc.Code numbers with which the engine answers."""

    OK = 0
    CANCELLED = 1
    INVALID_ARGUMENT = 3
    NOT_FOUND = 5
    ALREADY_EXISTS = 6
    RESOURCE_EXHAUSTED = 8
    FAILED_PRECONDITION = 9
    UNIMPLEMENTED = 12
    INTERNAL = 13
    UNAVAILABLE = 14
