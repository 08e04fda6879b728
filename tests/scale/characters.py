"""Characters that play in real time and record everything that a viewer could notice."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import grpc
import numpy as np

from motiongen_client import LinePolicy, MotionClient, Session, SessionOptions
from motiongen_client.errors import EventRefused, MotiongenError

PROMPTS = ("a person walks forward", "a person runs forward", "a person waves with the right hand", "a person stands")
ENCODER_AWAY = ("TEXT_ENCODER_UNAVAILABLE", "TEXT_ENCODER_SLOW")
CLIENTS = 4
EDIT_EVERY_S = 3.0
LOOK_EVERY_S = 0.01
POLICY = LinePolicy(ping_s=1.0, pong_timeout_s=1.0, hello_timeout_s=2.0)


@dataclass
class Character:
    """One session. lost_at, back_at: when connections were lost and restored, in pairs, monotonic seconds. changed:
    committed frames that changed before they were shown. unanswered: edits that were refused or never answered.
    put_off: edits that were refused until the text encoder is back, which counts as an answer. ended: why it ended.
    """

    session: Session
    lost_at: list[float] = field(default_factory=list)
    back_at: list[float] = field(default_factory=list)
    changed: int = 0
    shown: int = 0
    answered: int = 0
    unanswered: int = 0
    put_off: int = 0
    ended: str = ""
    promised: dict[int, np.ndarray] = field(default_factory=dict)

    @property
    def underruns(self) -> int:
        """Frame times without a new frame to show."""
        return self.session.stats.underruns

    @property
    def is_away(self) -> bool:
        """Whether it has no connection now."""
        return len(self.lost_at) > len(self.back_at)

    def away_s(self, begin: float) -> list[float]:
        """How long each connection that was lost since `begin`, and has been restored, was away."""
        return [back - lost for lost, back in zip(self.lost_at, self.back_at, strict=False) if lost >= begin]


class Cast:
    """All characters, on as many connections as a game with some servers would have. Use it as `async with`."""

    def __init__(self, address: str, count: int, authority: Path) -> None:
        credentials = grpc.ssl_channel_credentials(authority.read_bytes())
        self._clients = [
            # Enough keys that each server gets a share, whatever a proxy's hash makes of them.
            MotionClient(address, credentials=credentials, policy=POLICY, connect_timeout_s=30.0)
            for _ in range(CLIENTS)
        ]
        self._count = count
        self._tasks: list[asyncio.Task[None]] = []
        self.characters: list[Character] = []

    async def __aenter__(self) -> Cast:
        for client in self._clients:
            await client.connect()
        for index in range(self._count):
            client = self._clients[index % CLIENTS]
            options = SessionOptions(lookahead_frames=40)
            session = await client.open(PROMPTS[index % len(PROMPTS)], options=options, keep_s=5.0)
            self.characters.append(Character(session))
        self._tasks = [asyncio.create_task(self._live(each, index)) for index, each in enumerate(self.characters)]
        self._tasks.append(asyncio.create_task(self._look()))
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for client in self._clients:
            await client.close()

    async def _live(self, character: Character, index: int) -> None:
        directing = asyncio.create_task(_direct(character, index))
        try:
            async for frame in character.session.frames():
                character.shown += 1
                promised = character.promised.pop(frame.index, None)
                row = character.session.playback.row(frame.index)
                if promised is not None and not np.array_equal(promised, row):
                    character.changed += 1
                _note_promises(character)
        except MotiongenError as error:
            character.ended = str(error)
        finally:
            directing.cancel()

    async def _look(self) -> None:
        """Record when connections are lost and restored; sessions have no event for that."""
        while True:
            now = time.monotonic()
            for character in self.characters:
                is_away = character.session.is_away
                was_away = len(character.lost_at) > len(character.back_at)
                if is_away and not was_away:
                    character.lost_at.append(now)
                elif was_away and not is_away:
                    character.back_at.append(now)
            await asyncio.sleep(LOOK_EVERY_S)


def _note_promises(character: Character) -> None:
    playback = character.session.playback
    for frame in range(max(character.promised, default=playback.playhead) + 1, playback.committed_to):
        if frame < playback.received_to:
            character.promised[frame] = playback.row(frame).copy()


async def _direct(character: Character, index: int) -> None:
    """Keep sending prompts, each after the previous one was answered."""
    number = index
    while True:
        await asyncio.sleep(EDIT_EVERY_S)
        number += 1
        try:
            await character.session.set_prompt(PROMPTS[number % len(PROMPTS)])
        except EventRefused as refusal:
            if refusal.reason in ENCODER_AWAY:
                character.put_off += 1
            else:
                character.unanswered += 1
        except MotiongenError:
            character.unanswered += 1
        else:
            character.answered += 1


def percentile(values: Sequence[float], share: float) -> float:
    """The percentile; 0 without values."""
    return float(np.percentile(values, 100 * share)) if values else 0.0
