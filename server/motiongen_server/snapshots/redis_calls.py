"""A Redis that several servers share: opens a client, names it in messages, and turns failures into StoreFailed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

import redis

from motiongen_server.snapshots.store import StoreFailed

CALL_S = 0.5
"""How long a call may take."""


def open_client(url: str) -> redis.Redis:
    """A client that connects when needed, and reconnects when a connection breaks.

    Raises ValueError if the address is not that of a Redis, or has options that connections do not take.
    """
    check_readable(url)
    client = redis.Redis.from_url(url, socket_timeout=CALL_S, socket_connect_timeout=CALL_S, health_check_interval=0)
    pool = client.connection_pool
    if pool.connection_kwargs.get("decode_responses"):  # from the address, as text: "false" is true here
        raise ValueError(f"{name_of(url)} is given decode_responses; leave it out: records are bytes, not text")
    try:
        pool.connection_class(**pool.connection_kwargs)  # does not connect; otherwise only the first call would fail
    except (TypeError, redis.RedisError) as error:
        raise ValueError(f"{name_of(url)} is given an option that connections do not take: {error}") from error
    return client


def check_readable(url: str) -> None:
    """Raise ValueError, without naming the address, if its port is invalid, as when a password cuts it short."""
    try:
        parts = urlsplit(url)
        is_whole = parts.port != 0 and (parts.scheme == "unix" or "@" not in parts.path + parts.query + parts.fragment)
    except ValueError:
        is_whole = False
    if not is_whole:
        raise ValueError(
            "its address cannot be read; the port must be a number, and a password must have / as %2F, ? as %3F, "
            "# as %23, [ as %5B, ] as %5D and @ as %40"
        )


def name_of(url: str) -> str:
    """The address without its password, for messages. Raises ValueError if it is not that of a Redis."""
    check_readable(url)
    parts = urlsplit(url)
    if parts.scheme == "unix":
        return f"unix://{parts.path}"
    host = parts.hostname or ""
    return f"{parts.scheme}://{f'[{host}]' if ':' in host else host}:{parts.port or 6379}{parts.path}"


@contextmanager
def calling(name: str) -> Iterator[None]:
    """Turn failures of calls within the block into StoreFailed. name: of the Redis."""
    try:
        yield
    except (redis.RedisError, OSError, UnicodeError) as error:  # UnicodeError: an impossible host name, such as a..b
        raise StoreFailed(f"{name}: {type(error).__name__}: {error}") from error
