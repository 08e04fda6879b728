"""LinePolicy: how patient a client is with the line to its server."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_client.errors import InvalidInput


@dataclass(frozen=True)
class LinePolicy:
    """What a stream does when the line to its server is lost, and when it takes it for lost.

    recover_s: for how long a new call is tried for after one was lost, also where the server wishes nobody back for
    longer; None: for ever; 0: not at all, and the sessions fail with StreamLost. hello_timeout_s: how long a server may
    take to say hello. ping_s: how often it is asked for a sign of life, which must come within pong_timeout_s: else the
    call is given up as lost.
    """

    recover_s: float | None = None
    hello_timeout_s: float = 10.0
    ping_s: float = 5.0
    pong_timeout_s: float = 5.0

    def __post_init__(self) -> None:
        if self.recover_s is not None and self.recover_s < 0:
            raise InvalidInput("recover_s", self.recover_s, "seconds of 0 or more, or None for ever")
        for name in ("hello_timeout_s", "ping_s", "pong_timeout_s"):
            if getattr(self, name) <= 0:
                raise InvalidInput(name, getattr(self, name), "seconds above 0")
