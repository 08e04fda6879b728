"""StreamBudget: charges everything that a stream sends to the stream and to its peer, before looking at it.

Nothing is refused for exceeding the budget: a stream in debt is not read further until it has paid, and gRPC's flow
control passes the back-pressure on to the client. Tokens are events: at the default rates a stream has 5,000 a second.
When an address has used up what it may send, its streams have equal shares, so that none can starve the others.

Tokens cover what is known beforehand. The event loop time that a message really took is charged as well, once it has
been processed (`loop_time`), and is paid before the next message is read.
"""

from __future__ import annotations

from motiongen_server.engine.types import Code
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket

MESSAGE_COST = 1.0
EVENT_COST = 1.0
REFUSAL_COST = 9.0
"""Added for a refused event: its answer costs the server several times as much as taking the event does."""
RESUME_COST = REFUSAL_COST
"""Added for a resume, whether or not it is refused: a look-ahead of frames, which is sent again, costs as much as many
other answers."""
CONSTRAINT_COST = 3.0
"""Added for each constraint that is set: converting it here and placing it in an engine takes as long as this many
other events."""
PATH_COST = 50.0
"""Added for each path: working out where it leads takes the engine as long as this many other events."""
FREE = (Code.OK, Code.INTERNAL, Code.UNAVAILABLE)
"""Answers that are not charged: the client is not at fault."""
BYTES_A_TOKEN = 256.0
CALL_COST = 1.0
"""One call, out of the peer's calls_per_second; a clip's request costs more by its bytes."""
CONSTRAINT_CALLS = 0.01
"""Added for each constraint of each sample of a clip."""
PATH_CALLS = 0.25
"""Added for each such constraint that is a path."""
BYTES_A_CALL = 16_384.0


class StreamBudget:
    """Lives on the event loop. now: monotonic seconds. charged: tokens so far."""

    def __init__(self, rate: float, peer: Peer, now: float) -> None:
        self.peer = peer
        self.charged = 0.0
        self._bucket = TokenBucket(rate, now)
        self._share = Share(peer.events, lambda: peer.num_streams, now)
        self._bytes = Share(peer.bytes, lambda: peer.num_streams, now)
        self._loop = Share(peer.loop_part, lambda: peer.num_streams, now)

    def charge(self, tokens: float, now: float) -> None:
        """Charge tokens to the stream and to its peer."""
        self.charged += tokens
        self._bucket.charge(tokens, now)
        self._share.charge(tokens, now)

    def charge_message(self, num_bytes: int, now: float) -> None:
        """Charge a message that has come; its events are charged as they are counted."""
        self.charge(MESSAGE_COST + num_bytes / BYTES_A_TOKEN, now)
        self._bytes.charge(num_bytes, now)

    def charge_loop(self, seconds: float, now: float) -> None:
        """Charge the event loop time that the stream's messages took."""
        self._loop.charge(seconds, now)

    def loop_owed_s(self, now: float) -> float:
        """Seconds until the event loop time that the stream took is paid."""
        return self._loop.ahead_s(now)

    def owed_s(self, now: float) -> float:
        """Seconds until more of the stream may be read."""
        sent_s = max(self._bucket.owed_s(now), self._share.owed_s(now), self._bytes.owed_s(now))
        return max(sent_s, self._loop.ahead_s(now))
