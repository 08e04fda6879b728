"""What the viewer costs: `python -m tests.bench.viewer`; with `--minutes 10`, whether its memory stays constant.

Runs a server with the built-in model, `motiongen view`, and Chromium without a GPU. Pictures per second are those of
software rendering and say nothing about a machine with a GPU. The page's own computation, draw calls, bytes and the
bridge's share of a core do not depend on that.
"""

from __future__ import annotations

import argparse
import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import psutil

from motiongen_tools.console import make_console, make_table
from motiongen_tools.server_process import ServerProcess
from tests.system.view.chromium import Page, plain, start_chromium, viewer_process

MIB = 1 << 20
WATCH = """
globalThis.watched ??= { ms: [], bytes: 0, frames: 0, messages: 0, draw: requestAnimationFrame.bind(window) };
globalThis.requestAnimationFrame = (act) => watched.draw((now) => {
  const begin = performance.now();
  act(now);
  watched.ms.push(performance.now() - begin);
});
motiongen.connection.addEventListener("binary", ({ detail: { header, rows } }) => {
  watched.bytes += rows.buffer.byteLength;
  watched.messages += 1;
  for (const head of header.heads ?? []) watched.frames += head[6];
});
"""
START = """
const from = motiongen.stage.renderer.info.render.frame;
Object.assign(watched, { ms: [], bytes: 0, frames: 0, messages: 0, from });
"""


@dataclass(frozen=True)
class Row:
    """Measurements with one number of characters."""

    count: int
    hz: float
    plain_hz: float
    script_ms: float
    calls: int
    triangles: int
    kib_s: float
    frames_s: float
    bridge_share: float
    bridge_mib: float


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.viewer", description=__doc__)
    parser.add_argument("--counts", default="1,20,100,200", help="characters (default %(default)s)")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each measurement (default %(default)s)")
    parser.add_argument(
        "--minutes", type=int, default=0, help="watch memory for so long instead, printing one row per minute"
    )
    parser.add_argument("--precision", default="auto", help="of the server (default %(default)s)")
    parser.add_argument("--server", metavar="HOST:PORT", help="of a running server (default: start one)")
    options = parser.parse_args()
    settings = ["--admit-load", "1000", "--precision", options.precision, "--drain-wait-s", "0"]
    with contextlib.ExitStack() as stack:
        running, watched = options.server, []
        if running is None:
            server = stack.enter_context(ServerProcess(settings))
            running, watched = server.address, [psutil.Process(server.pid)]
        (address,), bridge = stack.enter_context(viewer_process(running))
        if options.minutes:
            watch_memory(address, psutil.Process(bridge), watched, options.minutes)
            return
        table = make_table(
            "the viewer", "characters", "Hz", "Hz, plain", "script ms", "draw calls", "triangles", "KiB/s", "frames/s",
            "bridge, of a core", "bridge MiB",
        )  # fmt: skip
        for count in map(int, options.counts.split(",")):
            row = measure(address, psutil.Process(bridge), count, options.seconds)
            table.add_row(
                str(row.count), f"{row.hz:.1f}", f"{row.plain_hz:.1f}", f"{row.script_ms:.1f}", str(row.calls),
                str(row.triangles), f"{row.kib_s:.0f}", f"{row.frames_s:.0f}", f"{row.bridge_share:.0%}",
                f"{row.bridge_mib:.0f}",
            )  # fmt: skip
        make_console().print(table)


def measure(address: str, bridge: psutil.Process, count: int, seconds: float) -> Row:
    """Measure with so many characters in their own room, which are removed again."""
    room = f"{address}?room=of-{count}"
    full = _watched(room, count, seconds)
    cheap = _watched(plain(room), count, seconds, bridge=bridge)
    silent = _watched(plain(room), count, seconds, draws=False, removes=True)
    return Row(
        count, full["hz"], cheap["hz"], silent["ms"], full["calls"], full["triangles"], cheap["bytes"] / 1024,
        cheap["frames"], cheap["share"], cheap["mib"],
    )  # fmt: skip


def _watched(
    address: str,
    count: int,
    seconds: float,
    *,
    bridge: psutil.Process | None = None,
    draws: bool = True,
    removes: bool = False,
) -> dict[str, Any]:
    """Watch a page in a new browser for so long. draws: False: do everything but draw."""
    driver = start_chromium(size=(1280, 860))
    try:
        page = Page(driver, address)
        page.until_shown()
        page.run(
            "const more = arguments[0] - motiongen.cast.members.size;"
            "if (more > 0) motiongen.cast.ask({ op: 'add', count: more, preset: 'walk', priority: 'crowd' })",
            count,
        )
        page.until("motiongen.cast.members.size === arguments[0]", count)
        page.until("[...motiongen.cast.members.values()].every(({ track }) => track.end > 0)")
        page.run("motiongen.stage.adapt = () => {}")  # otherwise it would reduce its quality while this measures
        if not draws:
            page.run("motiongen.stage.render = () => {}")
        page.run(WATCH)
        page.until("watched.ms.length > 2")
        page.run(START)
        begin, busy = time.perf_counter(), _cpu_s(bridge)
        time.sleep(seconds)
        told = page.run(
            "const { render } = motiongen.stage.renderer.info;"
            "const drawn = render.frame - watched.from;"
            "return { ...watched, drawn, calls: render.calls, triangles: render.triangles }"
        )
        spent = time.perf_counter() - begin
        if removes:
            page.run(
                "for (const n of motiongen.cast.members.keys()) motiongen.cast.ask({ op: 'remove', character: n })"
            )
            page.until("motiongen.cast.members.size === 0")
        return {
            "hz": told["drawn"] / spent, "ms": median(told["ms"]), "calls": told["calls"],
            "triangles": told["triangles"], "bytes": told["bytes"] / spent, "frames": told["frames"] / spent,
            "share": (_cpu_s(bridge) - busy) / spent, "mib": bridge.memory_info().rss / MIB if bridge else 0.0,
        }  # fmt: skip
    finally:
        driver.quit()


def watch_memory(address: str, bridge: psutil.Process, watched: Sequence[psutil.Process], minutes: int) -> None:
    """Edit eight characters every five seconds, and print a row per minute, after garbage collection."""
    console = make_console()
    driver = start_chromium(size=(500, 400))
    try:
        page = Page(driver, plain(address))
        page.until_shown()
        page.run("motiongen.cast.ask({ op: 'add', count: 7, preset: 'stand' })")
        page.until("motiongen.cast.members.size === 8")
        page.run(
            """
            const presets = motiongen.cast.models[0].presets.map(({ id }) => id);
            let n = 0;
            setInterval(() => {
              for (const number of motiongen.cast.members.keys()) {
                const preset = presets[(n + number) % presets.length];
                motiongen.connection.ask({ op: "set_prompt", preset, character: number });
              }
              motiongen.cast.tell({ op: "add_constraints", constraints: [
                { kind: "waypoint", frame: 0, at_any_frame: true, x_m: 2 * Math.sin(n), z_m: 2 * Math.cos(n) }] });
              n++;
            }, 5000);
            """
        )
        titles = ("minute", "page, MiB", "page: elements", "page: buffers on the GPU", "bridge, MiB", "servers, MiB")
        table = make_table("memory", *titles)
        for minute in range(minutes + 1):
            driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
            heap = driver.execute_cdp_cmd("Runtime.getHeapUsage", {})
            elements = page.run("return document.querySelectorAll('*').length")
            buffers = page.run("return motiongen.stage.renderer.info.memory.geometries")
            servers = [each for one in watched for each in (one, *one.children(recursive=True))]
            row = (
                str(minute), f"{(heap['usedSize'] + heap.get('backingStorageSize', 0)) / MIB:.1f}", str(elements),
                str(buffers), f"{bridge.memory_info().rss / MIB:.1f}",
                f"{sum(each.memory_info().rss for each in servers) / MIB:.0f}",
            )  # fmt: skip
            table.add_row(*row)
            console.print("  ".join(row))
            if minute < minutes:
                time.sleep(60)
        console.print(table)
    finally:
        driver.quit()


def _cpu_s(process: psutil.Process | None) -> float:
    if process is None:
        return 0.0
    times = process.cpu_times()
    return float(times.user + times.system)


if __name__ == "__main__":
    main()
