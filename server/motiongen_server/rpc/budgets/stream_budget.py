"""StreamBudget: everything that a stream sends is charged, to the stream and to its peer, before it is looked at.

Nothing is refused for being too much: a stream that owes is not read on until it has paid, and gRPC's flow control
passes the wait to the client. Tokens are events: at the default rates a stream has 5,000 a second. Where all that an
address may send is used up, its streams have equal parts of it, so that one of them cannot starve the others.

Tokens are what is known beforehand. What a message really took of the event loop is charged besides, once it is done
(`loop_time`), and is paid before the next is read.
"""

from __future__ import annotations

from motiongen_server.engine.types import Code
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket

MESSAGE_COST = 1.0
EVENT_COST = 1.0
REFUSAL_COST = 9.0
"""More, for an event that is refused: its answer costs the server several times what taking it does."""
CONSTRAINT_COST = 3.0
"""More, for each constraint that is set: what converts it here, and places it in an engine, takes the time of so many
other events."""
PATH_COST = 50.0
"""More, for each path: the engine works out where it leads, in the time of so many other events."""
FREE = (Code.OK, Code.INTERNAL, Code.UNAVAILABLE)
"""Answers that are not charged: the client is not at fault."""
BYTES_A_TOKEN = 256.0
CALL_COST = 1.0
"""Of a call, of those that a peer may make in a second; a clip's costs more by its bytes."""
CONSTRAINT_CALLS = 0.01
"""More, for each constraint of each sample of a clip."""
PATH_CALLS = 0.25
"""More, for each path of them."""
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
        """Use tokens, of the stream and of its peer."""
        self.charged += tokens
        self._bucket.charge(tokens, now)
        self._share.charge(tokens, now)

    def give_back(self, tokens: float, now: float) -> None:
        """What was charged beforehand, for a refusal, was none."""
        self._bucket.give_back(tokens, now)
        self._share.give_back(tokens, now)

    def charge_message(self, num_bytes: int, now: float) -> None:
        """A message has come; its events are charged as they are counted."""
        self.charge(MESSAGE_COST + num_bytes / BYTES_A_TOKEN, now)
        self._bytes.charge(num_bytes, now)

    def charge_loop(self, seconds: float, now: float) -> None:
        """What the stream has sent has taken so much of the event loop's time."""
        self._loop.charge(seconds, now)

    def loop_owed_s(self, now: float) -> float:
        """Seconds until what was taken of the event loop's time is paid."""
        return self._loop.ahead_s(now)

    def owed_s(self, now: float) -> float:
        """Seconds until the stream may be read on."""
        sent_s = max(self._bucket.owed_s(now), self._share.owed_s(now), self._bytes.owed_s(now))
        return max(sent_s, self._loop.ahead_s(now))
