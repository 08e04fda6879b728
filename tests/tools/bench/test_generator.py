"""One process of the load generator, against a server that makes mistakes on demand."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import grpc
import pytest

from motiongen_client import MotionClient, convert
from motiongen_client.errors import ServerUnavailable
from motiongen_tools.bench.clock import RealTime
from motiongen_tools.bench.generator import Generator
from motiongen_tools.bench.load import Load, Progress, Report
from motiongen_tools.bench.recorder import (
    ANSWER,
    EVENT,
    GENERATOR,
    LATENCIES,
    LATENESS,
    LOOP_LAG,
    OPEN,
    SEND_LAG,
    SLACK,
    Recorder,
)
from motiongen_tools.bench.scenario import load_scenario
from motiongen_tools.bench.terminal import LATENCY_NAMES
from tests.client.fake_server import FakeServer, FakeStream
from tests.client.synthetic import catalog


@pytest.fixture
def server(request: pytest.FixtureRequest) -> Iterator[FakeServer]:
    with FakeServer(frame_rate=getattr(request, "param", 20)) as running:
        yield running


@pytest.fixture
def load(server: FakeServer, short_scenario: Path) -> Load:
    return Load(server.address, load_scenario(str(short_scenario)), characters=6, seconds=1, seed=4)


class SleptTime(RealTime):
    """A clock that advances by the sleeps asked for: a busy machine makes the run longer, not the generator late."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    async def sleep(self, seconds: float) -> None:
        wake_s = self._now_s + seconds
        await super().sleep(seconds)
        self._now_s = max(self._now_s, wake_s)


class StalledTime(SleptTime):
    """A clock that jumps once, as if the process had been stalled."""

    def __init__(self, at_s: float, for_s: float) -> None:
        super().__init__()
        self._at_s, self._for_s = at_s, for_s

    async def sleep(self, seconds: float) -> None:
        await super().sleep(seconds)
        if self._now_s >= self._at_s:
            self._now_s += self._for_s
            self._for_s = 0.0


async def play(
    load: Load, at_each_tell: object = None, clock: SleptTime | None = None
) -> tuple[Recorder, Report, list[Progress]]:
    """Play the whole load in this process."""
    clock = clock or SleptTime()
    async with MotionClient(load.address) as client:
        generator = Generator(load, client.catalog, 0, clock)
    await generator.connect()
    told: list[Progress] = []

    def tell(progress: Progress) -> None:
        told.append(progress)
        if callable(at_each_tell):
            at_each_tell(progress)

    report = await generator.play(clock.now_s() + 0.05, tell)
    recorder = load.new_book(load.schedule().phases)
    recorder.merge(report.recorder)
    return recorder, report, told


def edits_received(streams: list[FakeStream]) -> int:
    kinds = ("edit_prompts", "edit_constraints")
    return sum(event.WhichOneof("event") in kinds for stream in streams for event in stream.received)


async def test_scheduled_events_are_sent_and_their_results_recorded(server: FakeServer, load: Load) -> None:
    schedule = load.schedule()
    recorder, report, told = await play(load)
    end_s = len(recorder.seconds["edits"]["near"])
    sent, skipped = recorder.total("edits", 0, end_s), recorder.counts["events_of_characters_that_are_not_there"]
    assert sent == edits_received(server.streams) > 10
    # On a busy machine a character may open too late for its first edits; what is left out is counted.
    assert sent + skipped == len(schedule.edit_at_s)
    assert recorder.total("opens", 0, end_s) == len(schedule.characters)
    assert (
        load.characters <= recorder.counts["sessions_opened"] <= len(schedule.characters)
    )  # the last may come too late
    assert report.streams == len(server.streams) == math.ceil(schedule.most_at_once() / 4)
    assert recorder.histogram(ANSWER).get_total_count() > 0
    assert recorder.counts["protocol_breaches"] == 0
    assert recorder.counts["streams_lost"] == 0
    assert max(progress.playing for progress in told) > 0


async def test_refused_edits_are_counted_and_others_continue(server: FakeServer, load: Load) -> None:
    server.refuse = lambda event: "CONSTRAINT_IN_THE_PAST" if event.WhichOneof("event") == "edit_constraints" else ""
    recorder, _, _ = await play(load)
    assert recorder.counts["refused edit: CONSTRAINT_IN_THE_PAST"] > 0
    assert recorder.histogram(EVENT, "passing").get_total_count() == 0
    assert recorder.histogram(EVENT, "near").get_total_count() > 0


async def test_a_refused_open_ends_the_character(server: FakeServer, load: Load) -> None:
    server.refuse = lambda event: "SERVER_FULL"
    recorder, _, _ = await play(load)
    # how many are sent and answered before the end depends on the machine
    assert load.characters <= recorder.counts["refused open: SERVER_FULL"] <= len(load.schedule().characters)
    assert recorder.counts["sessions_opened"] == 0
    assert recorder.total("due", 0, 3) == 0
    assert recorder.histogram(EVENT).get_total_count() == 0


@pytest.mark.parametrize("server", [100], indirect=True)
async def test_characters_of_a_lost_stream_miss_every_frame_once_they_have_played_what_came(
    server: FakeServer, load: Load
) -> None:
    load = replace(load, seconds=2)
    last_s = load.schedule().phases.measure_to_s

    def lose(progress: Progress) -> None:
        if progress.at_s >= 1:
            for stream in server.streams:
                stream.fail(grpc.StatusCode.UNAVAILABLE)

    recorder, _, _ = await play(load, lose)
    assert recorder.counts["streams_lost"] == len(server.streams)
    # gRPC says INTERNAL of a call that it loses in the middle of a write, so the status is not always the server's
    assert sum(n for name, n in recorder.counts.items() if name.startswith("stream_lost: ")) == len(server.streams)
    assert recorder.counts["sessions_lost: STREAM_LOST"] > 0
    due = load.scenario.tail_s * server.frame_rate * load.characters / 2  # that group is half of them, and stays
    assert recorder.total("due", last_s, last_s + 1, "near") == pytest.approx(due)
    assert recorder.total("missed", last_s, last_s + 1, "near") == pytest.approx(due, abs=load.characters / 2)


async def test_characters_that_cannot_be_opened_count_as_without_a_frame(server: FakeServer, load: Load) -> None:
    def lose(progress: Progress) -> None:
        for stream in server.streams:
            stream.fail(grpc.StatusCode.UNAVAILABLE)

    load = replace(load, seconds=2)
    recorder, _, _ = await play(load, lose)
    assert recorder.counts["characters_without_a_frame"] >= recorder.counts["opens_not_sent"] > 0
    assert recorder.histogram(OPEN).get_total_count() == len(load.schedule().characters), (
        "each of them counts as waiting"
    )


@pytest.fixture
def measured_from_the_start(short_scenario: Path) -> Path:
    text = short_scenario.read_text(encoding="utf-8").replace("ramp_s: 0.2", "ramp_s: 0")
    short_scenario.write_text(text.replace("life: {median_s: 1, sigma: 0.5}", "life: {median_s: 80000, sigma: 0}"))
    return short_scenario


async def test_a_stall_of_the_generator_is_weighted_by_its_duration(load: Load, measured_from_the_start: Path) -> None:
    load = replace(load, scenario=load_scenario(str(measured_from_the_start)))
    recorder, _, _ = await play(load, clock=StalledTime(0.3, for_s=0.5))
    lags = recorder.histogram(LOOP_LAG, GENERATOR)
    assert lags.get_value_at_percentile(60) > 10_000, "the stall takes half of the second, and is more than one sample"
    assert lags.get_total_count() > 80, "a hundred samples a second, despite the stall"


async def test_a_stall_until_the_end_of_the_measurement_counts_as_lag(
    load: Load, measured_from_the_start: Path
) -> None:
    load = replace(load, scenario=load_scenario(str(measured_from_the_start)))
    schedule = load.schedule()
    recorder, _, _ = await play(load, clock=StalledTime(0.6, for_s=1.2))
    meant = [*schedule.edit_at_s.tolist(), *(plan.open_s for plan in schedule.characters)]
    assert recorder.histogram(SEND_LAG, GENERATOR).get_total_count() == sum(0 <= at_s < 1 for at_s in meant)
    assert recorder.histogram(SEND_LAG, GENERATOR).get_max_value() > 500_000
    assert recorder.histogram(LOOP_LAG, GENERATOR).get_max_value() > 500_000


def test_processes_share_a_load_without_overlap(load: Load) -> None:
    load = replace(load, characters=40, processes=3, address="localhost:1")
    known = convert.catalog(catalog(20))
    parts = [Generator(load, known, process).numbers() for process in range(3)]
    assert sorted(number for part in parts for number in part) == list(range(len(load.schedule().characters)))
    assert min(map(len, parts)) > 0


async def test_an_unreachable_server_is_reported(load: Load, server: FakeServer) -> None:
    async with MotionClient(server.address) as client:
        generator = Generator(replace(load, address="127.0.0.1:1"), client.catalog, 0)
    with pytest.raises(ServerUnavailable, match=r"127\.0\.0\.1:1"):
        await generator.connect()


def test_every_latency_has_a_printed_name_except_those_drawn_as_histograms() -> None:
    assert {*LATENCY_NAMES, LATENESS, SLACK} == set(LATENCIES)
