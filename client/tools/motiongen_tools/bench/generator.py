"""One process of the load: its streams, its part of the schedule, and the measurement of its own lag."""

from __future__ import annotations

import asyncio
import gc
import math
import time
from collections.abc import Callable

import numpy as np

from motiongen_client.types import Catalog
from motiongen_tools.bench import edits
from motiongen_tools.bench.character import Character, make_jitter
from motiongen_tools.bench.clock import LoadClock, RealTime
from motiongen_tools.bench.load import Load, Progress, Report
from motiongen_tools.bench.recorder import GENERATOR, LOOP_LAG, ROUND_TRIP, SEND_LAG, STREAMS
from motiongen_tools.bench.stream_client import StreamClient, report

_TICK_S = 0.025
_MOST_TURNS = 25  # per tick: streams act in turn, as independent clients would
_LEAST_SLEEP_S = 0.001  # events within a millisecond share a wake-up
_PROBE_S = 0.01
_PING_TICKS = 80  # between pings of a stream: 2 s
_HANDLES_FROM = 1


class Generator:
    """Plays one process's part of a load. Call `connect`, then `play` with the time at which the run starts."""

    def __init__(self, load: Load, catalog: Catalog, process: int, clock: LoadClock | None = None) -> None:
        self._clock = clock or RealTime()
        self._load = load
        self._catalog = catalog
        self._process = process
        self._schedule = load.schedule()
        self._phases = self._schedule.phases
        self._groups = load.scenario.groups
        self._recorder = load.new_book(self._phases)
        self._started_at_s = math.nan  # on the clock
        self._cpu_from_s: float | None = None
        self._cpu_to_s: float | None = None
        self._make_lanes()

    def _make_lanes(self) -> None:
        """Make this process's streams: every processes-th of all. Characters are dealt to all streams in turn."""
        load, schedule = self._load, self._schedule
        num_lanes = load.num_streams(schedule, self._catalog.limits.max_sessions_per_stream)
        fps, jitter = self._catalog.rigs[0].frame_rate_hz, make_jitter()
        max_bytes = self._catalog.limits.max_request_bytes
        self._lanes: list[StreamClient] = []
        self._lane_of: dict[int, StreamClient] = {}
        self._character_of: dict[int, Character] = {}
        for index in range(self._process, num_lanes, load.processes):
            stream_client = StreamClient(
                load.address, max_bytes, self._now_s, self._recorder, load.connection, self._note_round_trip
            )
            self._lanes.append(stream_client)
            members = []
            for plan in schedule.characters[index::num_lanes]:
                group = self._groups[plan.group].name
                handle = _HANDLES_FROM + plan.number // num_lanes
                character = Character(
                    handle, plan, group, fps=fps, jitter=jitter, phases=self._phases, recorder=self._recorder
                )
                self._lane_of[plan.number], self._character_of[plan.number] = stream_client, character
                members.append((character, group))
            stream_client.adopt(members)
        self._intents = self._draw_up()
        self._take_turns()

    def _take_turns(self) -> None:
        """Distribute reports of playheads and pings over ticks, and within a tick over turns."""
        self._num_turns = turns = min(len(self._lanes), _MOST_TURNS)
        num_slices = max(1, round(1 / (self._load.scenario.report_hz * _TICK_S)))
        self._reports: list[list[tuple[StreamClient, Character]]] = [[] for _ in range(num_slices * turns)]
        self._pings: list[list[StreamClient]] = [[] for _ in range(_PING_TICKS * turns)]
        for index, lane in enumerate(self._lanes):
            # Seven steps through all turns, so that a stream is not always pinged in the turn in which it reports.
            self._pings[index * 7 % len(self._pings)].append(lane)
        turn_of = {lane: index % turns for index, lane in enumerate(self._lanes)}
        for number, character in self._character_of.items():
            lane = self._lane_of[number]
            self._reports[number % num_slices * turns + turn_of[lane]].append((lane, character))

    def _draw_up(self) -> list[tuple[float, int, int, int]]:
        """(at_s, character, rule, value) of everything that this process is to send. Rule -1 opens, -2 closes."""
        schedule = self._schedule
        intents = []
        for number, character in self._character_of.items():
            intents.append((character.plan.open_s, number, _OPEN, 0))
            if character.plan.close_s < math.inf:
                intents.append((character.plan.close_s, number, _CLOSE, 0))
        mine = np.isin(schedule.edit_character, np.fromiter(self._character_of, np.int64, len(self._character_of)))
        columns = (schedule.edit_at_s, schedule.edit_character, schedule.edit_rule, schedule.edit_value)
        intents += zip(*(column[mine].tolist() for column in columns), strict=True)
        return sorted(intents)

    def numbers(self) -> list[int]:
        """The numbers of this process's characters."""
        return sorted(self._character_of)

    async def connect(self) -> None:
        """Open the streams. Raises ServerUnavailable."""
        self._started_at_s = self._clock.now_s()
        await asyncio.gather(*(stream_client.start() for stream_client in self._lanes))

    async def play(self, start_at_s: float, tell: Callable[[Progress], None]) -> Report:
        """Play the schedule from start_at_s on the clock. tell: called once a second."""
        self._started_at_s = start_at_s
        gc.collect()
        gc.freeze()  # keeps collections short: the load's own pauses would count as the server's
        try:
            probe = asyncio.create_task(self._probe(), name="bench-probe")
            await self._drive(tell)
            probe.cancel()
            await asyncio.gather(probe, return_exceptions=True)
        finally:
            gc.unfreeze()
        end_s = self._now_s()
        for character in self._character_of.values():
            character.look(end_s)
            character.give_up_edits(end_s)
            character.end(end_s, as_planned=True)
        made = Report(  # made now, as in motiongen-load: what comes while streams end is not part of it
            process=self._process,
            recorder=self._recorder.pack(),
            cpu_s=(self._cpu_to_s or time.process_time()) - (self._cpu_from_s or time.process_time()),
            streams=len(self._lanes),
        )
        await asyncio.gather(*(stream_client.stop() for stream_client in self._lanes))
        return made

    def _now_s(self) -> float:
        return self._clock.now_s() - self._started_at_s

    async def _drive(self, tell: Callable[[Progress], None]) -> None:
        intents, position = self._intents, 0
        turn_s, next_turn, next_tell_s = _TICK_S / self._num_turns, 0, 0.0
        while True:
            now_s = self._now_s()
            while position < len(intents) and intents[position][0] <= now_s:
                self._act(*intents[position])
                position += 1
            if now_s >= next_turn * turn_s:
                last = max(next_turn, int(now_s / turn_s))
                # Missed ticks are not made up for.
                for turn in range(max(next_turn, last - self._num_turns + 1), last + 1):
                    self._report_playheads(self._reports[turn % len(self._reports)], now_s)
                    for stream_client in self._pings[turn % len(self._pings)]:
                        stream_client.put_ping()
                next_turn = last + 1
                self._note_cpu(now_s)
                if now_s >= next_tell_s:
                    next_tell_s = now_s + 1.0
                    tell(self._progress(now_s))
            for stream_client in self._lanes:
                stream_client.flush()
            if now_s >= self._phases.end_s:
                return
            next_s = min(next_turn * turn_s, intents[position][0] if position < len(intents) else math.inf)
            await self._clock.sleep(max(next_s - self._now_s(), _LEAST_SLEEP_S))

    def _act(self, intended_s: float, number: int, rule: int, value: int) -> None:
        character, stream_client = self._character_of[number], self._lane_of[number]
        group = self._groups[character.plan.group]
        now_s = self._now_s()
        if rule == _OPEN:
            character.open_sent = True
            if stream_client.lost:  # to its player, the character is lost
                self._recorder.counts["opens_not_sent"] += 1
                character.end(now_s, as_planned=False)
                return
            stream_client.put(edits.open_event(character, group, self._load.denoise_steps))
            self._recorder.add("opens", group.name, intended_s)
        elif not character.is_live:
            self._recorder.counts["events_of_characters_that_are_not_there"] += 1
            return
        elif rule == _CLOSE:
            stream_client.put(edits.close_event(character))
            character.drop_edits()
            character.end(now_s, as_planned=True)
        else:
            told = group.edits[rule]
            event = edits.edit_event(
                character, group, told, value, intended_s=intended_s, now_s=now_s, catalog=self._catalog
            )
            stream_client.put(event)
            self._recorder.add("edits", group.name, intended_s)
        self._record_lag(SEND_LAG, intended_s, now_s - intended_s)

    def _report_playheads(self, members: list[tuple[StreamClient, Character]], now_s: float) -> None:
        for stream_client, character in members:
            if character.is_playing:
                character.look(now_s)
                stream_client.put(report(character, now_s))

    async def _probe(self) -> None:
        """Measure how late the event loop wakes a sleeper."""
        while True:
            due_s = self._now_s() + _PROBE_S
            try:
                await self._clock.sleep(_PROBE_S)
            finally:  # the run may end before it wakes
                self._note_loop_lag(due_s)

    def _note_loop_lag(self, due_s: float) -> None:
        """Record the lag of a probe, and of those that would have been due until it was woken.

        Otherwise a stall would be a single sample among a hundred a second, however long it was.
        """
        now_s = self._now_s()
        while due_s <= now_s:
            self._record_lag(LOOP_LAG, due_s, now_s - due_s)
            due_s += _PROBE_S

    def _note_round_trip(self, now_s: float, seconds: float) -> None:
        self._record(ROUND_TRIP, STREAMS, now_s, seconds)

    def _record_lag(self, what: str, due_s: float, lag_s: float) -> None:
        """Attributed to when it was due, as edits' latencies are: a stall may last until the end of the measurement."""
        self._record(what, GENERATOR, due_s, max(lag_s, 0.0))

    def _record(self, what: str, owner: str, at_s: float, seconds: float) -> None:
        """Record a value if its time is within the measurement."""
        if self._phases.measure_from_s <= at_s < self._phases.measure_to_s:
            self._recorder.record(what, owner, seconds)

    def _note_cpu(self, now_s: float) -> None:
        if self._cpu_from_s is None and now_s >= self._phases.measure_from_s:
            self._cpu_from_s = time.process_time()
        if self._cpu_to_s is None and now_s >= self._phases.measure_to_s:
            self._cpu_to_s = time.process_time()

    def _progress(self, now_s: float) -> Progress:
        second = int(now_s)
        return Progress(
            process=self._process,
            at_s=now_s,
            playing=sum(character.is_playing for character in self._character_of.values()),
            missed=round(self._recorder.total("missed", second - 1, second)) if second else 0,
            edits=round(self._recorder.total("edits", 0, second + 1)),
            refused=round(self._recorder.total("refused", 0, second + 1)),
        )


_OPEN, _CLOSE = -1, -2
