"""Hostile clients whose playheads are possible, but run faster than real time; see `tests.attack.hostile`."""

from __future__ import annotations

from motiongen.v1 import service_pb2_grpc, session_pb2
from tests.attack.calls import STREAMS, channel_to, many
from tests.attack.hostile_load import FPS, Crowd

SESSIONS = 4
"""Sessions on each stream: they keep the machine busy, but not full."""
FASTER = 3.0
LEAP_EVERY_S = 1.0


class FastPlayers(Crowd):
    """Play at three times real time, as long as there are frames."""

    def _playhead(self, handle: int, now: float) -> session_pb2.Playhead:
        end = self._sent_to[handle]
        frame = min(int((now - self._begun_s[handle]) * FASTER * FPS), max(0, end - 1))
        return session_pb2.Playhead(frame=frame, buffered_to=end)


class Teleporters(Crowd):
    """Play in real time, and once a second jump to the last frame that they hold."""

    _leapt_s: float = 0.0

    def _playhead(self, handle: int, now: float) -> session_pb2.Playhead:
        if now - self._leapt_s > LEAP_EVERY_S:
            self._leapt_s = now
            for each in self._begun_s:  # continue from there
                self._begun_s[each] = now - max(0, self._sent_to[each] - 1) / FPS
        return super()._playhead(handle, now)


async def _play(kind: type[Crowd], address: str) -> None:
    async def once() -> None:
        async with channel_to(address) as channel:
            await kind(service_pb2_grpc.MotionServiceStub(channel).StreamMotion(), SESSIONS).play()

    await many(STREAMS, once)


async def fast_players(address: str) -> None:
    """32 sessions that play at three times real time."""
    await _play(FastPlayers, address)


async def teleporters(address: str) -> None:
    """32 sessions that once a second jump to the last frame they hold, and play on from there."""
    await _play(Teleporters, address)
