"""Browser: one page and its WebSocket: what it sends, and what it is sent at each beat."""

from __future__ import annotations

import asyncio
import json
import logging
from typing import Any, Protocol

from motiongen_client.errors import InvalidInput, MotiongenError
from motiongen_client.types import Catalog
from motiongen_tools.view import fields
from motiongen_tools.view.access import Role
from motiongen_tools.view.bridge import Bridge
from motiongen_tools.view.character import Character
from motiongen_tools.view.fields import Message
from motiongen_tools.view.room import Room
from motiongen_tools.view.session_file import session_of
from motiongen_tools.view.wire import Head, catalog_json, pack_frames, pack_history, rig_json, to_json

HEAD_PERIOD_S = 0.25
"""A page's clock runs by itself; this often it is sent the real playhead."""
MOST_HISTORY_S = 200.0
MOST_WAITING = 32
"""Most answers, pieces of history and requests under way. A page that has as many is not read until some are done."""
FOR_WATCHERS = ("ping", "history")

_log = logging.getLogger(__name__)


class Socket(Protocol):
    """The interface of a WebSocket that a browser needs. Sending waits while the other side is slow."""

    async def send_text(self, data: str) -> None: ...

    async def send_bytes(self, data: bytes) -> None: ...

    async def receive_text(self) -> str: ...


class Browser:
    """One page. A slow page gets fewer messages, not outdated ones: each has what the page lacks when it is sent."""

    def __init__(self, socket: Socket, bridge: Bridge, room: Room, role: Role) -> None:
        self._socket = socket
        self._bridge = bridge
        self._room = room
        self._role = role
        self._sent_to: dict[int, int] = {}
        self._told: dict[int, int] = {}  # character -> its revision
        self._headed_at_s: dict[int, float] = {}
        self._changes = -1
        self._line: dict[str, Any] = {}
        self._catalog: Catalog | None = None
        self._answers: list[dict[str, Any]] = []
        self._histories: list[tuple[Character, int, int]] = []  # with first and end frame
        self._tasks: set[asyncio.Task[None]] = set()

    # ---- called by the room

    def rewind(self, character: int, frame: int) -> None:
        """Frames from here on are new or replaced: send them again."""
        if character in self._sent_to:
            self._sent_to[character] = min(self._sent_to[character], frame)

    def forget(self, character: int) -> None:
        """The character has been removed."""
        for book in (self._sent_to, self._told, self._headed_at_s):
            book.pop(character, None)

    # ---- both directions

    async def serve(self) -> None:
        """Serve the page until it is gone; then raises what its socket raises."""
        self._room.viewers.add(self)
        telling = asyncio.create_task(self._tell())
        hearing = asyncio.create_task(self._hear())
        try:
            done, _ = await asyncio.wait((telling, hearing), return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._room.viewers.discard(self)
            for task in (telling, hearing, *self._tasks):
                task.cancel()
            await asyncio.gather(telling, hearing, *self._tasks, return_exceptions=True)

    async def _tell(self) -> None:
        while True:
            for message in self.news():
                await self._socket.send_text(to_json(message))
            histories, self._histories = self._histories, []
            for character, first, end in histories:  # packed only when sent: each may have a megabyte
                await self._socket.send_bytes(pack_history(character.number, *character.history(first, end)))
            heads = self.heads()
            if heads:
                await self._socket.send_bytes(pack_frames(heads))
            await self._bridge.beat()

    def news(self) -> list[dict[str, Any]]:
        """The messages that the page has not been sent yet."""
        room, line = self._room, self._bridge.line
        news, self._answers = self._answers, []
        shown = line.shown(len(room.characters))
        if shown != self._line:
            self._line = shown
            news.append({"type": "server", "role": self._role.value, **shown})
        if line.has_catalog and line.client.catalog is not self._catalog:  # the first, or one of another server
            self._catalog = line.client.catalog
            news.append({"type": "catalog", **catalog_json(self._catalog)})
        if room.changes != self._changes:
            self._changes = room.changes
            news.append(room.listed())
        for number, character in room.characters.items():
            if self._told.get(number) != character.revision:
                self._told[number] = character.revision
                news.append({"type": "character", **character.shown(), **self._rig_besides(character)})
        return news

    def _rig_besides(self, character: Character) -> dict[str, Any]:
        """The character's rig, if the catalogue no longer has it: the page needs it to read and draw frames."""
        rig = character.session.rig
        is_offered = self._catalog is not None and any(each.rig_id == rig.rig_id for each in self._catalog.rigs)
        return {} if is_offered else {"described": rig_json(rig)}

    def heads(self) -> list[Head]:
        """Frames that the page has not been sent yet, of characters that it knows."""
        heads, now_s = [], self._room.clock()
        for number, character in self._room.characters.items():
            if number not in self._told:
                continue  # added while a message was sent: the page must know the character before its frames
            buffered_to = character.session.playback.buffered_to
            sent_to = self._sent_to.get(number, 0)
            is_due = now_s - self._headed_at_s.get(number, -HEAD_PERIOD_S) >= HEAD_PERIOD_S
            if sent_to < buffered_to or is_due:
                heads.append(character.head(now_s, sent_to))
                self._sent_to[number] = buffered_to
                self._headed_at_s[number] = now_s
        return heads

    @property
    def num_waiting(self) -> int:
        """How many things the page has asked for and has not been sent."""
        return len(self._answers) + len(self._histories) + len(self._tasks)

    async def _hear(self) -> None:
        while True:
            while self.num_waiting >= MOST_WAITING:  # the page asks for more than it reads
                await self._bridge.beat()
            try:
                message = json.loads(await self._socket.receive_text())
            except (ValueError, RecursionError, KeyError):
                # ValueError: also a number with thousands of digits; KeyError: bytes instead of text
                message = None
            if not isinstance(message, dict):
                self._answer(None, error="the message is not a JSON object")
                continue
            if message.get("op") == "ping":
                self._answer(message, at=message.get("at"))
                continue
            task = asyncio.create_task(self._do(message))  # keys must not wait for an open
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _do(self, message: Message) -> None:
        try:
            self._answer(message, **await self._carry_out(message))
        except MotiongenError as error:
            self._answer(message, error=str(error))
        except Exception:
            _log.exception("a message of a page failed")
            self._answer(message, error="the bridge failed to do this; its log says why")

    async def _carry_out(self, message: Message) -> dict[str, Any]:
        operation = message.get("op")
        if self._role is not Role.CONTROL and operation not in FOR_WATCHERS:
            raise InvalidInput("op", operation, "only watching: this page was opened with the token for spectators")
        match operation:
            case "add":
                return {"numbers": await self._room.add(message)}
            case "remove":
                await self._room.remove(fields.whole(message, "character"))
                return {}
        character = self._room.character(fields.whole(message, "character"))
        match operation:
            case "again":
                changes = fields.mapping(message, "changes") if "changes" in message else {}
                return {"numbers": [await self._room.again(session_of(character), changes)]}
            case "history":
                first = fields.whole(message, "first_frame")
                most = character.session.rig.frames_in(MOST_HISTORY_S)
                end = fields.whole(message, "end_frame", first, first + most)
                self._histories.append((character, first, end))
                return {}
            case "time_scale":
                character.set_time_scale(fields.number(message, "scale"))
                return {}
        told = {key: value for key, value in message.items() if key not in ("character", "request")}
        return {"entry": character.tell(told).number}

    def _answer(self, message: Message | None, **fields_: Any) -> None:
        request = None if message is None else message.get("request")
        operation = None if message is None else message.get("op")
        self._answers.append({"type": "answer", "request": request, "op": operation, **fields_})
