"""RedisStore: snapshots in Redis or Valkey, for servers on many machines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

from motiongen_server.snapshots.redis_calls import calling, name_of, open_client
from motiongen_server.snapshots.store import Held, Lease, Renewal

PREFIX = "motiongen:session:"
# Redis runs each script as one atomic step, so epoch and record always match. KEYS[1]: a hash of e (epoch), h (holder)
# and d (the record).
_SAVE = """
local held = tonumber(redis.call('HGET', KEYS[1], 'e') or '0')
if held > tonumber(ARGV[1]) then return 0 end
redis.call('HSET', KEYS[1], 'e', ARGV[1], 'd', ARGV[2])
redis.call('PEXPIRE', KEYS[1], ARGV[3])
return 1
"""
_READ = """
local held = redis.call('HMGET', KEYS[1], 'e', 'd')
if not held[2] then return false end
return {tonumber(held[1]), held[2]}
"""
_TAKE = """
local held = redis.call('HMGET', KEYS[1], 'e', 'd')
if not held[2] or held[1] ~= ARGV[1] then return false end
local epoch = redis.call('HINCRBY', KEYS[1], 'e', 1)
redis.call('HSET', KEYS[1], 'h', ARGV[2])
redis.call('PEXPIRE', KEYS[1], ARGV[3])
return {epoch, held[2]}
"""
_RENEW = """
local held = redis.call('HGET', KEYS[1], 'e')
if not held then return 2 end
if tonumber(held) > tonumber(ARGV[1]) then return 0 end
redis.call('PEXPIRE', KEYS[1], ARGV[2])
return 1
"""
_DROP = "if redis.call('HGET', KEYS[1], 'e') == ARGV[1] then return redis.call('DEL', KEYS[1]) end return 0"


class RedisStore:
    """Connects when needed, and reconnects when a connection breaks."""

    def __init__(self, url: str, keep_s: float) -> None:
        """keep_s: how long a record stays without being renewed. Raises ValueError if url is not that of a Redis."""
        self._keep_ms = round(1000 * keep_s)
        self._name = name_of(url)
        self._client = open_client(url)

    def __str__(self) -> str:
        return self._name

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        """As in SnapshotStore: one round trip for all."""
        answers = self._all(_SAVE, [(lease.name, (lease.epoch, data, self._keep_ms)) for lease, data in records])
        return [answer == 1 for answer in answers]

    def read(self, name: str) -> Held | None:
        """As in SnapshotStore."""
        (answer,) = self._all(_READ, [(name, ())])
        return _held(answer)

    def take(self, lease: Lease, holder: str) -> Held | None:
        """As in SnapshotStore."""
        (answer,) = self._all(_TAKE, [(lease.name, (lease.epoch, holder, self._keep_ms))])
        return _held(answer)

    def renew(self, leases: Sequence[Lease]) -> list[Renewal]:
        """As in SnapshotStore."""
        answers = self._all(_RENEW, [(lease.name, (lease.epoch, self._keep_ms)) for lease in leases])
        return [Renewal(answer) for answer in answers]

    def drop(self, leases: Sequence[Lease]) -> None:
        """As in SnapshotStore."""
        self._all(_DROP, [(lease.name, (lease.epoch,)) for lease in leases])

    def close(self) -> None:
        """As in SnapshotStore."""
        self._client.close()

    def _all(self, script: str, calls: Sequence[tuple[str, tuple[str | bytes | int, ...]]]) -> list[Any]:
        """Run a script for each of many records, in one round trip. Raises StoreFailed."""
        if not calls:
            return []
        with calling(self._name):
            pipeline = self._client.pipeline(transaction=False)
            for name, arguments in calls:
                pipeline.eval(script, 1, PREFIX + name, *cast("tuple[str, ...]", arguments))
            return pipeline.execute()


def _held(answer: Any) -> Held | None:
    return None if answer is None else Held(int(answer[0]), bytes(answer[1]))
