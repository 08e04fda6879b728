"""A Redis that several servers share: its client, its name, and what a call of it fails with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import redis

from motiongen_server.snapshots.store import StoreFailed

CALL_S = 0.5
"""How long a call may take."""


def open_client(url: str) -> redis.Redis:
    """Connections are made when they are needed, and anew when they break.

    Raises ValueError for no address of one, and for options in it that no connection takes.
    """
    client = redis.Redis.from_url(url, socket_timeout=CALL_S, socket_connect_timeout=CALL_S, health_check_interval=0)
    pool = client.connection_pool
    if pool.connection_kwargs.get("decode_responses"):  # by the address; "false" is given as that word
        raise ValueError(f"{name_of(url)} is given decode_responses; leave it out: what is kept there are bytes")
    try:
        pool.connection_class(**pool.connection_kwargs)  # connects to nobody; else the first call would find out
    except (TypeError, redis.RedisError) as error:
        raise ValueError(f"{name_of(url)} is given an option that no connection takes: {error}") from error
    return client


def name_of(url: str) -> str:
    """Its address without a password, for messages. Raises ValueError where it has no such address."""
    parts = urlsplit(url)
    if parts.scheme == "unix":
        return f"unix://{parts.path}"
    host = parts.hostname or ""
    try:
        port = parts.port or 6379
    except ValueError:  # whose message has what stands there, which may be a part of the password
        raise ValueError(
            f"the {parts.scheme}: address has no port where one should be; "
            "in a password write %2F for /, %23 for #, %40 for @"
        ) from None
    return f"{parts.scheme}://{f'[{host}]' if ':' in host else host}:{port}{parts.path}"


@contextmanager
def calling(name: str) -> Iterator[None]:
    """Raise StoreFailed for what calls within it fail with. name: of the Redis."""
    try:
        yield
    except (redis.RedisError, OSError, UnicodeError) as error:  # UnicodeError: of a host that is no name, as a..b
        raise StoreFailed(f"{name}: {type(error).__name__}: {error}") from error
