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
    check_readable(url)
    client = redis.Redis.from_url(url, socket_timeout=CALL_S, socket_connect_timeout=CALL_S, health_check_interval=0)
    pool = client.connection_pool
    if pool.connection_kwargs.get("decode_responses"):  # by the address; "false" is given as that word
        raise ValueError(f"{name_of(url)} is given decode_responses; leave it out: what is kept there are bytes")
    try:
        pool.connection_class(**pool.connection_kwargs)  # connects to nobody; else the first call would find out
    except (TypeError, redis.RedisError) as error:
        raise ValueError(f"{name_of(url)} is given an option that no connection takes: {error}") from error
    return client


def check_readable(url: str) -> None:
    """Raise ValueError for an address whose port is none, as where a password ends it too early, which is not said."""
    try:
        parts = urlsplit(url)
        is_whole = parts.port != 0 and (parts.scheme == "unix" or "@" not in parts.path + parts.query + parts.fragment)
    except ValueError:
        is_whole = False
    if not is_whole:
        raise ValueError(
            "its address cannot be read; the port must be a number, and a password has / as %2F, ? as %3F, # as %23, "
            "[ as %5B, ] as %5D and @ as %40"
        )


def name_of(url: str) -> str:
    """Its address without a password, for messages. Raises ValueError for no address of one."""
    check_readable(url)
    parts = urlsplit(url)
    if parts.scheme == "unix":
        return f"unix://{parts.path}"
    host = parts.hostname or ""
    return f"{parts.scheme}://{f'[{host}]' if ':' in host else host}:{parts.port or 6379}{parts.path}"


@contextmanager
def calling(name: str) -> Iterator[None]:
    """Raise StoreFailed for what calls within it fail with. name: of the Redis."""
    try:
        yield
    except (redis.RedisError, OSError, UnicodeError) as error:  # UnicodeError: of a host that is no name, as a..b
        raise StoreFailed(f"{name}: {type(error).__name__}: {error}") from error
