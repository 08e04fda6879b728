"""The Redis store of snapshots, with a real Redis."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import redis

from motiongen_server.snapshots.redis_store import RedisStore
from motiongen_server.snapshots.store import Lease, Renewal, StoreFailed
from tests.server.snapshots.store_contract import StoreContract, Two
from tests.system.real_redis import start_redis, url_in

pytestmark = pytest.mark.system

KEEP_S = 60.0


@pytest.fixture(scope="module")
def redis_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("redis")
    process = start_redis(folder)
    yield url_in(folder)
    process.terminate()
    process.wait()


@pytest.fixture
def stores(redis_url: str) -> Iterator[Two]:
    redis.Redis.from_url(redis_url).flushall()
    two = RedisStore(redis_url, KEEP_S), RedisStore(redis_url, KEEP_S)
    yield two
    for store in two:
        store.close()


class TestRedis(StoreContract):
    """A Redis that two servers share."""


def test_redis_records_expire(redis_url: str) -> None:
    store = RedisStore(redis_url, KEEP_S)
    store.save([(Lease("expiring", 1), b"x")])
    left_ms = redis.Redis.from_url(redis_url).pttl("motiongen:session:expiring")
    assert 0 < int(left_ms) <= KEEP_S * 1000  # type: ignore[arg-type]


def test_unavailable_or_full_redis_raises_an_error_without_its_password(redis_url: str, tmp_path: Path) -> None:
    away = RedisStore(f"unix://user:secret@{tmp_path}/none.sock", KEEP_S)
    with pytest.raises(StoreFailed) as failed:
        away.save([(Lease("a", 1), b"x")])
    assert "secret" not in str(failed.value)
    client = redis.Redis.from_url(redis_url)
    client.config_set("maxmemory", "1")
    try:
        with pytest.raises(StoreFailed, match="OutOfMemory"):
            RedisStore(redis_url, KEEP_S).save([(Lease("full", 1), bytes(1000))])
    finally:
        client.config_set("maxmemory", "0")


def test_full_redis_still_renews_and_drops_records(redis_url: str) -> None:
    """So saved sessions outlive a time in which nothing can be saved, and make room when they are over."""
    store, client = RedisStore(redis_url, KEEP_S), redis.Redis.from_url(redis_url)
    kept, over = Lease("k", 1), Lease("o", 1)
    store.save([(kept, b"x"), (over, b"y")])
    client.config_set("maxmemory", "1")
    try:
        client.pexpire("motiongen:session:k", 1000)
        assert store.renew([kept]) == [Renewal.KEPT]
        left_ms = client.pttl("motiongen:session:k")
        assert int(left_ms) > 1000  # type: ignore[arg-type]
        store.drop([over])
        assert store.read("o") is None
    finally:
        client.config_set("maxmemory", "0")
