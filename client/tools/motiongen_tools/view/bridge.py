"""Bridge: all rooms of characters, and the beat at which characters move and browsers are updated."""

from __future__ import annotations

import asyncio
import re

from motiongen_client.errors import InvalidInput
from motiongen_tools.view.line import Line
from motiongen_tools.view.room import Room

TICK_S = 1 / 30
MOST_ROOMS = 16
_ROOM = re.compile(r"[\w-]{1,40}")


class Bridge:
    """All rooms, over one connection to the server. Whoever updates a browser awaits `beat`."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.rooms: dict[str, Room] = {}
        self._beat = asyncio.Event()

    def room(self, name: str) -> Room:
        """The room of a name, created if it does not exist. Raises InvalidInput."""
        if not _ROOM.fullmatch(name):
            raise InvalidInput("room", name, "1 to 40 letters, digits, _ and -")
        if name not in self.rooms:
            self._forget_empty()
            if len(self.rooms) >= MOST_ROOMS:
                raise InvalidInput("room", name, f"one of the {MOST_ROOMS} there are: {', '.join(self.rooms)}")
            self.rooms[name] = Room(name, self.line)
        return self.rooms[name]

    def _forget_empty(self) -> None:
        empty = [name for name, room in self.rooms.items() if room.is_empty]
        for name in empty:
            del self.rooms[name]

    async def beat(self) -> None:
        """Wait until every character has moved once more."""
        await self._beat.wait()

    def tick(self) -> None:
        """Move every character to the present, and wake those who wait for the beat."""
        for room in self.rooms.values():
            room.tick()
        self._beat.set()
        self._beat.clear()  # whoever waits is still woken; later calls wait for the next beat

    async def run(self) -> None:
        """Connect, and tick for ever."""
        connecting = asyncio.create_task(self.line.run())
        try:
            while True:
                if connecting.done():
                    connecting.result()
                self.tick()
                await asyncio.sleep(TICK_S)
        finally:
            connecting.cancel()
            for room in self.rooms.values():
                await room.close()
            await self.line.close()
