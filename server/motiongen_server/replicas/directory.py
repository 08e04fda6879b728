"""RedisDirectory: the servers of one store, as each tells of itself every second and is forgotten when it does not."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol, cast

from motiongen_server.snapshots.redis_calls import calling, name_of, open_client

SERVERS, SEEN = "motiongen:servers", "motiongen:servers:seen"
KEEP_MS = 3000
"""For which a server that says nothing counts as there."""
KNOWN = 8
"""Others that one learns of at a time, drawn at random: a thousand servers cost the store no more than eight."""
MOST_BYTES = 8192
"""Of what a server tells of itself; what is longer is not read."""
MOST_CHARACTERS = 256
# KEYS: a hash of what servers tell, by name; when each was seen, milliseconds of the store's clock. ARGV: name, what it
# tells, how long it counts, how many to draw.
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
    """What a server tells of itself. name: another for each process. free_shares: by model, as in EnginePort.

    address: where clients reach it, "" where that is not told; routing_key: one by which a proxy has led a client
    there, "" where none came by one.
    """

    name: str
    address: str
    routing_key: str
    free_shares: Mapping[str, float]


class Directory(Protocol):
    """Called from one thread. Every call ends within a second or so, or raises StoreFailed."""

    def exchange(self, own: Replica) -> list[Replica]:
        """Tell of this server, and learn of some others."""
        ...

    def leave(self, name: str) -> None:
        """Be forgotten."""
        ...

    def close(self) -> None:
        """Let go of the connection."""
        ...


class RedisDirectory:
    """In a Redis of version 6.2 or later, or a Valkey."""

    def __init__(self, url: str) -> None:
        """Raises ValueError for what is no address of a Redis."""
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
    """Whether a client can be told it. JSON may hold what is no text, with which no message could be made."""
    return len(text) <= MOST_CHARACTERS and text.isprintable()


def read_replica(name: str, text: bytes) -> Replica | None:
    """What another server has told; None where that is nothing of this kind, as from a later version."""
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
