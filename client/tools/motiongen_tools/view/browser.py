"""Browser: one page over its WebSocket: what it says, and what it is told at each beat."""

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
"""A page's clock runs by itself; this often it is told where the playhead really is."""
MOST_HISTORY_S = 200.0
MOST_WAITING = 32
"""Answers, pieces of history and requests under way; a page that has as many is not listened to until some are gone."""
FOR_WATCHERS = ("ping", "history")

_log = logging.getLogger(__name__)


class Socket(Protocol):
    """What a browser needs of a WebSocket. Sending waits while the other side is slow."""

    async def send_text(self, data: str) -> None: ...

    async def send_bytes(self, data: bytes) -> None: ...

    async def receive_text(self) -> str: ...


class Browser:
    """Slow pages get fewer messages, never old ones: each is made of what the page lacks when it is sent."""

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

    # ---- for the room

    def rewind(self, character: int, frame: int) -> None:
        """Frames from here on are new or replaced."""
        if character in self._sent_to:
            self._sent_to[character] = min(self._sent_to[character], frame)

    def forget(self, character: int) -> None:
        """There is no such character any more."""
        for book in (self._sent_to, self._told, self._headed_at_s):
            book.pop(character, None)

    # ---- both directions

    async def serve(self) -> None:
        """Until the page is gone; raises what its socket raises then."""
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
            for character, first, end in histories:  # each is packed when it is sent: it may be of a megabyte
                await self._socket.send_bytes(pack_history(character.number, *character.history(first, end)))
            heads = self.heads()
            if heads:
                await self._socket.send_bytes(pack_frames(heads))
            await self._bridge.beat()

    def news(self) -> list[dict[str, Any]]:
        """The messages that the page has not been told yet."""
        room, line = self._room, self._bridge.line
        news, self._answers = self._answers, []
        shown = line.shown(len(room.characters))
        if shown != self._line:
            self._line = shown
            news.append({"type": "server", "role": self._role.value, **shown})
        if line.has_catalog and line.client.catalog is not self._catalog:  # the first, or another server's
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
        """Its rig, where the catalogue has that no more: the page could not draw it, nor tell whose rows are whose."""
        rig = character.session.rig
        is_offered = self._catalog is not None and any(each.rig_id == rig.rig_id for each in self._catalog.rigs)
        return {} if is_offered else {"described": rig_json(rig)}

    def heads(self) -> list[Head]:
        """Frames that the page has not been sent yet, of characters that it knows."""
        heads, now_s = [], self._room.clock()
        for number, character in self._room.characters.items():
            if number not in self._told:
                continue  # it came while a message was sent: first the page is to know whose frames these are
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
        """What the page has asked for, and has not been sent."""
        return len(self._answers) + len(self._histories) + len(self._tasks)

    async def _hear(self) -> None:
        while True:
            while self.num_waiting >= MOST_WAITING:  # it asks for more than it reads
                await self._bridge.beat()
            try:
                message = json.loads(await self._socket.receive_text())
            except (ValueError, RecursionError, KeyError):
                # ValueError: also a number of thousands of digits; KeyError: bytes have come, and no text
                message = None
            if not isinstance(message, dict):
                self._answer(None, error="the message is not a JSON object")
                continue
            if message.get("op") == "ping":
                self._answer(message, at=message.get("at"))
                continue
            task = asyncio.create_task(self._do(message))  # opening takes a while, and a key must not wait for it
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _do(self, message: Message) -> None:
        try:
            self._answer(message, **await self._carry_out(message))
        except MotiongenError as error:
            self._answer(message, error=str(error))
        except Exception:
            _log.exception("a message of a page failed")
            self._answer(message, error="the bridge failed at this; its log says why")

    async def _carry_out(self, message: Message) -> dict[str, Any]:
        operation = message.get("op")
        if self._role is not Role.CONTROL and operation not in FOR_WATCHERS:
            raise InvalidInput("op", operation, "looking on: this page was opened with the token of spectators")
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
