"""LinePolicy: how patient a client is with the connection to its server."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_client.types import check_number


@dataclass(frozen=True)
class LinePolicy:
    """When a stream considers the connection to its server lost, and what it does then.

    recover_s: for how long it tries to make a new call after one was lost, even if the server asked clients to stay
    away for longer; None: without end; 0: not at all, so that its sessions fail with StreamLost. hello_timeout_s: how
    long a server may take to say hello. ping_s: how often it is pinged; a call without a pong within pong_timeout_s is
    given up as lost.
    """

    recover_s: float | None = None
    hello_timeout_s: float = 10.0
    ping_s: float = 5.0
    pong_timeout_s: float = 5.0

    def __post_init__(self) -> None:
        if self.recover_s is not None:
            check_number("recover_s", self.recover_s, "seconds of 0 or more, or None for ever", lambda s: s >= 0)
        for name in ("hello_timeout_s", "ping_s", "pong_timeout_s"):
            check_number(name, getattr(self, name), "seconds above 0", lambda s: s > 0)
