"""Servers that tell each other their free capacity through a real Redis."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from motiongen_server.replicas.directory import KNOWN, RedisDirectory, Replica
from motiongen_server.snapshots.store import StoreFailed
from tests.system.real_redis import start_redis, url_in
from tests.waiting import until

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("redis")
    process = start_redis(folder)
    yield url_in(folder)
    process.kill()
    process.wait()


def replica(name: str, share: float = 0.5) -> Replica:
    return Replica(name, f"{name}:1", "0123456789abcdef", {"m": share})


def test_each_server_learns_the_current_state_of_the_others(url: str) -> None:
    one, other = RedisDirectory(url), RedisDirectory(url)
    assert one.exchange(replica("one")) == []
    assert other.exchange(replica("other", 0.25)) == [replica("one")]
    assert one.exchange(replica("one", 0.125)) == [replica("other", 0.25)]
    assert other.exchange(replica("other")) == [replica("one", 0.125)]
    other.leave("other")
    assert one.exchange(replica("one")) == []
    one.leave("one")
    one.close()
    other.close()


def test_varying_selection_of_many_servers_is_returned(url: str) -> None:
    directory = RedisDirectory(url)
    for number in range(40):
        directory.exchange(replica(f"s{number}"))
    told = [frozenset(each.name for each in directory.exchange(replica("s0"))) for _ in range(20)]
    assert {len(each) for each in told} == {KNOWN}
    assert len(set(told)) > 1
    assert "s0" not in frozenset().union(*told)
    for number in range(40):
        directory.leave(f"s{number}")
    directory.close()


def test_silent_server_is_forgotten(url: str) -> None:
    directory = RedisDirectory(url)
    directory.exchange(replica("silent"))
    until(lambda: directory.exchange(replica("lively")) == [])
    directory.close()


def test_unavailable_redis_raises_an_error(tmp_path: Path) -> None:
    directory = RedisDirectory(url_in(tmp_path))
    with pytest.raises(StoreFailed):
        directory.exchange(replica("one"))
    with pytest.raises(StoreFailed):
        directory.leave("one")
    directory.close()
