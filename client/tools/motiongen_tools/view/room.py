"""Room: characters that several browsers see and steer together."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from motiongen_client.errors import InvalidInput, MotiongenError
from motiongen_client.types import SessionOptions, StartPose
from motiongen_tools.arguments import MOST_SEED
from motiongen_tools.view import fields
from motiongen_tools.view.character import Character
from motiongen_tools.view.commands import PRIORITIES, read_prompt
from motiongen_tools.view.fields import Message
from motiongen_tools.view.line import Line
from motiongen_tools.view.rehearsal import Rehearsal
from motiongen_tools.view.session_file import OPENING, SessionFile

MOST_CHARACTERS = 200
KEEP_S = 120.0
"""How much of the played motion can be looked at again, and recorded."""
SPACING_M = 1.6
MOST_SEED_DIGITS = 20  # of 2^64 - 1
IDLE_S = 20.0
"""After how long characters that nobody watches pause."""


class Viewer(Protocol):
    """The interface of a browser that a room needs."""

    def rewind(self, character: int, frame: int) -> None:
        """Frames from here on are new or replaced."""

    def forget(self, character: int) -> None:
        """The character has been removed."""


class Room:
    """name: as in the address of the page. changes: counts characters that were added or removed."""

    def __init__(self, name: str, line: Line, clock: Callable[[], float] = time.monotonic) -> None:
        self.name = name
        self.changes = 0
        self.characters: dict[int, Character] = {}
        self.viewers: set[Viewer] = set()
        self.clock = clock
        self._line = line
        self._next = 1
        self._places: set[int] = set()  # taken by characters, or by those that are being opened
        self._place_of: dict[int, int] = {}
        self._num_opening = 0
        self._watched_at_s = clock()
        self._idle: set[int] = set()  # characters paused because nobody is watching

    @property
    def is_empty(self) -> bool:
        """Whether it has no characters, none is being opened, and nobody is watching."""
        return not (self.characters or self.viewers or self._num_opening)

    async def add(self, message: Message) -> list[int]:
        """Open as many characters as a message asks for. Returns their numbers. Raises InvalidInput, EventRefused."""
        count = fields.whole(message, "count", 1, MOST_CHARACTERS, default=1)
        most = MOST_CHARACTERS - len(self.characters) - self._num_opening
        if count > most:
            raise InvalidInput("count", count, f"at most {most} more: a room holds {MOST_CHARACTERS}")
        self._num_opening += count
        try:
            opened = await asyncio.gather(*(self._open(message) for _ in range(count)), return_exceptions=True)
        finally:
            self._num_opening -= count
        failures = [each for each in opened if isinstance(each, BaseException)]
        numbers = [each for each in opened if isinstance(each, int)]
        if failures:
            first = failures[0]
            if numbers and isinstance(first, MotiongenError):
                raise InvalidInput("count", count, f"{len(numbers)}, which are open; the others were refused: {first}")
            raise first
        return numbers

    async def _open(self, message: Message) -> int:
        return await self._open_as(message, None)

    async def _open_as(self, message: Message, rehearsal: Rehearsal | None) -> int:
        place = next(each for each in itertools.count(1) if each not in self._places)
        self._places.add(place)
        try:
            number = await self._open_at(place, message, rehearsal)
        except BaseException:
            self._places.discard(place)
            raise
        return number

    async def _open_at(self, place: int, message: Message, rehearsal: Rehearsal | None) -> int:
        number, self._next = self._next, self._next + 1
        has_prompt = message.get("text") or message.get("preset")
        prompt = read_prompt(message) if has_prompt else None
        options = session_options(message, place_of(place))
        name = fields.text(message, "name", "") or f"character {number}"
        session = await self._line.client.open(prompt, options=options, keep_s=KEEP_S)
        try:
            model = self._line.client.catalog.model(session.opened.model_id)
        except MotiongenError:  # it was loaded since then, and the page does not know it
            await session.close()
            raise
        self.characters[number] = Character(
            number, name[:60], session, options=options, model=model, opening=message, rehearsal=rehearsal
        )
        self._place_of[number] = place
        self.changes += 1
        return number

    async def again(self, recorded: SessionFile, changes: Message) -> int:
        """Open a character that repeats the edits of a recorded one, at the same frames. Returns its number.

        recorded: that character; changes: fields of its opening to override, such as `steps`. Raises InvalidInput and
        EventRefused.
        """
        if len(self.characters) + self._num_opening >= MOST_CHARACTERS:
            raise InvalidInput("characters", MOST_CHARACTERS, f"at most {MOST_CHARACTERS}: remove one")
        unknown = [name for name in changes if name not in OPENING]
        if unknown:
            raise InvalidInput(unknown[0], changes[unknown[0]], f"only {', '.join(OPENING)}")
        opening = {**recorded.opening, **{key: value for key, value in changes.items() if value is not None}}
        self._num_opening += 1
        try:
            return await self._open_as(opening, Rehearsal(recorded.edits, recorded.num_frames))
        finally:
            self._num_opening -= 1

    async def remove(self, number: int) -> None:
        """Remove a character. Raises InvalidInput."""
        character = self.character(number)
        del self.characters[number]
        self._places.discard(self._place_of.pop(number))
        self._idle.discard(number)
        self.changes += 1
        for viewer in self.viewers:
            viewer.forget(number)
        await character.close()

    def character(self, number: int) -> Character:
        """The character of a number. Raises InvalidInput."""
        found = self.characters.get(number)
        if found is None:
            known = ", ".join(map(str, self.characters))
            raise InvalidInput("character", number, f"one of {known}" if known else "none: the room is empty; add one")
        return found

    def tick(self) -> None:
        """Move every character to the present, and tell the viewers which frames are new."""
        self._mind_the_unwatched()
        for character in self.characters.values():
            changed = character.tick()
            if changed is not None:
                for viewer in self.viewers:
                    viewer.rewind(character.number, changed)

    def _mind_the_unwatched(self) -> None:
        """Pause characters that nobody watches, and resume them when somebody does."""
        if self.viewers:
            self._watched_at_s = self.clock()
            idle, self._idle = self._idle, set()
            for number in idle:
                with contextlib.suppress(MotiongenError):  # it has ended meanwhile, which its next ticks will notice
                    self.characters[number].rest(is_over=True)
        elif self.clock() - self._watched_at_s > IDLE_S:
            for character in self.characters.values():
                if not character.session.is_paused and not character.has_ended:
                    self._idle.add(character.number)
                    with contextlib.suppress(MotiongenError):
                        character.rest()

    def listed(self) -> dict[str, Any]:
        """The list of characters, as a message."""
        return {"type": "characters", "room": self.name, "numbers": sorted(self.characters)}

    async def close(self) -> None:
        """Close all characters."""
        for number in list(self.characters):
            with contextlib.suppress(MotiongenError):
                await self.remove(number)


def session_options(message: Message, start: StartPose) -> SessionOptions:
    """The options with which a message asks for a session. Raises InvalidInput."""
    priority = fields.text(message, "priority", "near")
    if priority not in PRIORITIES:
        raise InvalidInput("priority", priority, f"one of {', '.join(PRIORITIES)}")
    seed = message.get("seed")
    if isinstance(seed, str) and len(seed) <= MOST_SEED_DIGITS and seed.isdecimal():
        message = {**message, "seed": int(seed)}  # a string, because it may have more digits than a browser's numbers
    if message.get("start") is not None:
        given = fields.mapping(message, "start")
        heading = fields.number(given, "heading_rad", 0.0)
        start = StartPose(fields.number(given, "x_m"), fields.number(given, "z_m"), heading)
    return SessionOptions(
        model_id=fields.text(message, "model", ""),
        seed=fields.optional_whole(message, "seed", 0, MOST_SEED),
        priority=PRIORITIES[priority],
        lookahead_frames=fields.optional_whole(message, "lookahead_frames", 1, 1 << 31),
        denoise_steps=fields.optional_whole(message, "steps", 1, 1 << 31),
        text_guidance=fields.optional_number(message, "text_guidance"),
        constraint_guidance=fields.optional_number(message, "constraint_guidance"),
        history_frames=fields.optional_whole(message, "history_frames", 1, 1 << 31),
        start=start,
        keep_prompts=fields.flag(message, "keep_prompts"),
    )


def place_of(place: int) -> StartPose:
    """Where a character starts: on a grid that grows from the middle, so that the first is in the camera's view."""
    ring = math.ceil((math.sqrt(place) - 1) / 2)
    if ring == 0:
        return StartPose()
    side, at = divmod(place - (2 * ring - 1) ** 2 - 1, 2 * ring)
    along, out = at - ring + 1, ring
    x, z = [(along, out), (out, -along), (-along, -out), (-out, along)][side]
    return StartPose(x * SPACING_M, z * SPACING_M)
