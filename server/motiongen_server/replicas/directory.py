"""RedisDirectory: the servers of one store. Each reports to it every second, and is forgotten when it stops."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, cast

from motiongen_server.snapshots.redis_calls import calling, name_of, open_client

SERVERS, SEEN = "motiongen:servers", "motiongen:servers:seen"
KEEP_MS = 3000
"""How long a server that does not report counts as present."""
KNOWN = 8
"""How many others a server learns of at a time, drawn at random, so that a call costs the same with 1,000 servers."""
MOST_BYTES = 8192
"""Of a server's report; longer ones are not read."""
MOST_CHARACTERS = 256
# KEYS: a hash of servers' reports, by name; when each was seen, milliseconds of the store's clock. ARGV: name, report,
# how long it counts, how many to draw.
_EXCHANGE = """
local time = redis.call('TIME')
local now = time[1] * 1000 + math.floor(time[2] / 1000)
redis.call('HSET', KEYS[1], ARGV[1], ARGV[2])
redis.call('ZADD', KEYS[2], now, ARGV[1])
local gone = redis.call('ZRANGEBYSCORE', KEYS[2], '-inf', now - ARGV[3], 'LIMIT', 0, 64)
if #gone > 0 then
  redis.call('HDEL', KEYS[1], unpack(gone))
  redis.call('ZREM', KEYS[2], unpack(gone))
end
redis.call('PEXPIRE', KEYS[1], 10 * ARGV[3])
redis.call('PEXPIRE', KEYS[2], 10 * ARGV[3])
return redis.call('HRANDFIELD', KEYS[1], ARGV[4], 'WITHVALUES')
"""


class Replica(NamedTuple):
    """A server's report. name: unique for each process. free_shares: by model, as in EnginePort.

    address: where clients reach it, "" if it does not say; routing_key: one by which a proxy has routed a client to it,
    "" if none has.
    """

    name: str
    address: str
    routing_key: str
    free_shares: Mapping[str, float]


class Directory(Protocol):
    """Called from one thread. Every call ends within a second or so, or raises StoreFailed."""

    def exchange(self, own: Replica) -> list[Replica]:
        """Report this server, and learn of some others."""
        ...

    def leave(self, name: str) -> None:
        """Remove this server's report."""
        ...

    def close(self) -> None:
        """Close the connection."""
        ...


class RedisDirectory:
    """Uses a Redis of version 6.2 or later, or a Valkey."""

    def __init__(self, url: str) -> None:
        """Raises ValueError if url is not the address of a Redis."""
        self._name = name_of(url)
        self._client = open_client(url)

    def exchange(self, own: Replica) -> list[Replica]:
        """As in Directory."""
        said = json.dumps({"address": own.address, "key": own.routing_key, "free": dict(own.free_shares)})
        arguments = (SERVERS, SEEN, own.name, said, KEEP_MS, KNOWN + 1)
        with calling(self._name):
            found: list[bytes] = self._client.eval(_EXCHANGE, 2, *cast("tuple[str, ...]", arguments))
        pairs = zip(found[::2], found[1::2], strict=False)
        read = (read_replica(name.decode(errors="replace"), text) for name, text in pairs)
        return [each for each in read if each is not None and each.name != own.name][:KNOWN]

    def leave(self, name: str) -> None:
        """As in Directory."""
        with calling(self._name):
            self._client.hdel(SERVERS, name)
            self._client.zrem(SEEN, name)

    def close(self) -> None:
        """As in Directory."""
        self._client.close()


def _can_be_told(text: str) -> bool:
    """Whether clients can be sent a text: JSON may hold lone surrogates, which a message cannot."""
    return len(text) <= MOST_CHARACTERS and text.isprintable()


def read_replica(name: str, text: bytes) -> Replica | None:
    """Another server's report; None if it cannot be read, for example because it is from a later version."""
    if len(text) > MOST_BYTES:
        return None
    try:
        said: Any = json.loads(text)
        address, key, free = said["address"], said["key"], said["free"]
        shares = {str(model): float(share) for model, share in free.items()}
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        return None
    if not all(isinstance(each, str) and _can_be_told(each) for each in (address, key)) or not key.isascii():
        return None
    if not all(0.0 <= share <= 1.0 for share in shares.values()):
        return None
    return Replica(name, address, key, shares)
