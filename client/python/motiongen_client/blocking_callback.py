"""BlockingCallback: an attribute of a blocking session that is a callback of the session with asyncio behind it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from motiongen_client import session

T = TypeVar("T")


class HasInner(Protocol):
    """A blocking session. _inner: the one behind it."""

    _inner: session.Session


class BlockingCallback(Generic[T]):
    """Reads and sets the callback of the same name. It is called on the client's background thread."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, holder: HasInner | None, owner: type) -> Callable[[T], None] | None:
        if holder is None:
            return None  # asked of the class, as `help` does
        callback: Callable[[T], None] | None = getattr(holder._inner, self._name)
        return callback

    def __set__(self, holder: HasInner, callback: Callable[[T], None] | None) -> None:
        setattr(holder._inner, self._name, callback)
