"""What a server uses while it is measured: processor time and memory, and discarded denoising steps."""

from __future__ import annotations

from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from types import SimpleNamespace

import psutil
import pytest

from motiongen_tools.bench import server_use
from motiongen_tools.bench.schedule import Phases
from motiongen_tools.bench.server_use import ServerUse, ServerWatch, thrown_away, total
from tests.http_serving import serving

METRICS = """# HELP motiongen_batch_rows Rows in a denoising step.
# TYPE motiongen_batch_rows histogram
motiongen_batch_rows_bucket{engine="0",le="1.0",model="core27"} 3.0
motiongen_batch_rows_sum{engine="0",model="core27"} 120.0
motiongen_batch_rows_sum{engine="1",model="core27"} 80.0
motiongen_steps_discarded_total{engine="0",model="core27"} 6.0
motiongen_steps_discarded_total{engine="1",model="core27"} 4.0
motiongen_frames_sent_total 17.0
"""


def test_a_metric_is_summed_over_its_labels() -> None:
    assert total(METRICS, "motiongen_batch_rows_sum") == 200.0
    assert total(METRICS, "motiongen_steps_discarded_total") == 10.0
    assert total(METRICS, "motiongen_frames_sent_total") == 17.0
    assert total(METRICS, "motiongen_steps") == 0.0


def test_the_share_of_discarded_steps_is_that_between_two_readings() -> None:
    assert thrown_away((200.0, 10.0), (300.0, 12.0)) == pytest.approx(0.02)
    assert thrown_away((200.0, 10.0), (200.0, 10.0)) is None
    assert thrown_away(None, (300.0, 12.0)) is None


MIB = 2**20
MEASURING = Phases(ramp_s=0, measure_from_s=0, measure_to_s=2, end_s=2)


@dataclass(eq=False)
class MadeUp:
    """A process as psutil shows it. seconds, mib: what it has used at each look; where they end, it has ended too."""

    seconds: list[float]
    mib: list[float]
    below: list[MadeUp] = field(default_factory=list)
    looks: int = 0

    def children(self, recursive: bool) -> list[MadeUp]:
        assert recursive
        return self.below

    def cpu_times(self) -> SimpleNamespace:
        if self.looks == len(self.seconds):
            raise psutil.NoSuchProcess(1)
        self.looks += 1
        used_s = self.seconds[self.looks - 1]
        return SimpleNamespace(user=0.75 * used_s, system=0.25 * used_s)

    def memory_info(self) -> SimpleNamespace:
        return SimpleNamespace(rss=self.mib[self.looks - 1] * MIB)

    def is_running(self) -> bool:
        return True

    def status(self) -> str:
        return psutil.STATUS_ZOMBIE if len(self.seconds) < LOOKS else psutil.STATUS_SLEEPING


LOOKS = 4  # before, two while measuring, after


async def use_of(monkeypatch: pytest.MonkeyPatch, server: MadeUp, ops_address: str = "") -> ServerUse | None:
    """The use of a server that is looked at four times in two seconds."""
    times = iter([100.0, 100.0, 100.0, 101.0, 102.0, 102.0])
    monkeypatch.setattr(psutil, "Process", lambda pid: server)
    monkeypatch.setattr(server_use, "time", SimpleNamespace(monotonic=lambda: next(times)))
    monkeypatch.setattr(server_use, "_SAMPLE_PERIOD_S", 0)
    return await ServerWatch(1, ops_address).follow(100.0, MEASURING)


async def test_use_is_that_of_all_processes_while_measuring(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = MadeUp([30.0, 30.5, 31.0, 31.5], [200, 400, 300, 900])
    server = MadeUp([5.0, 5.25, 5.5, 6.0], [50, 50, 60, 60], [engine])
    assert await use_of(monkeypatch, server) == ServerUse(cores=1.25, peak_mib=450)


async def test_an_engine_that_is_lost_counts_until_it_ends_and_its_successor_from_its_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lost, successor = MadeUp([30.0, 31.0], [200, 200]), MadeUp([0.5, 1.0], [100, 100])
    server = MadeUp([5.0, 5.0, 5.0, 6.0], [50, 50, 50, 50])
    monkeypatch.setattr(MadeUp, "children", lambda self, recursive: [lost] if self.looks < 2 else [lost, successor])
    assert await use_of(monkeypatch, server) == ServerUse(cores=1.5, peak_mib=250)


async def test_the_use_of_a_server_that_ended_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = MadeUp([30.0, 31.0], [200, 200])
    assert await use_of(monkeypatch, MadeUp([5.0, 5.0], [50, 50], [engine])) is None


async def test_metrics_that_are_cut_off_leave_the_rest_of_the_use_known(monkeypatch: pytest.MonkeyPatch) -> None:
    class CutOff(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "1000")
            self.end_headers()
            self.wfile.write(b"motiongen_batch_rows_sum 1.0")

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    server = MadeUp([1.0] * LOOKS, [50] * LOOKS)
    with serving(CutOff) as url:
        assert await use_of(monkeypatch, server, url.removeprefix("http://")) == ServerUse(cores=0, peak_mib=50)
