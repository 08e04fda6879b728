"""Calls to a Redis raise `StoreFailed`, whatever is wrong with its address."""

from __future__ import annotations

import pytest

from motiongen_server.snapshots.redis_calls import calling, open_client
from motiongen_server.snapshots.store import StoreFailed


@pytest.mark.parametrize("host", ["a..b", "x" * 70, "localhost:1"])
def test_invalid_host_is_a_failure_of_the_store(host: str) -> None:
    client = open_client(f"redis://{host}/0")
    with pytest.raises(StoreFailed, match=r"^the store: "), calling("the store"):
        client.ping()
    client.close()
