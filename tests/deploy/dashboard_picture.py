"""`python -m tests.deploy.dashboard_picture`: draw the dashboard's panels from a real Prometheus.

Two real servers whose model computes nothing play a scenario; Grafana is not needed. Each panel is drawn in its place,
with its queries, legends, unit and limit.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tests.deploy.dashboard import REPOSITORY, Panel, panels
from tests.deploy.watched_servers import Prometheus
from tests.scale.replicas import NULL_SERVER, Replica
from tests.waiting import until

STEP_S = 2.0
COLUMN, LINE = 0.29, 0.30
"""Size of a cell of the grid, in inches."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.deploy.dashboard_picture", description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="duration of the load (default: %(default)s)")
    parser.add_argument("--characters", type=int, default=40, help="on each server (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures" / "dashboard.png")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        store = f"sqlite:{folder / 'snapshots.sqlite'}"
        servers = [Replica(f"server-{letter}", folder, store, program=NULL_SERVER) for letter in "ab"]
        for server in servers:
            server.begin()
            stack.callback(server.stop)
        for server in servers:
            until(lambda server=server: server.is_ready)  # type: ignore[misc]
        prometheus = stack.enter_context(Prometheus(folder, [server.behind.ops_port for server in servers]))
        begun_at = time.time()
        loads = [play(server.behind.port, options.characters, options.seconds, folder) for server in servers]
        for load in loads:
            load.wait()
        print(draw(prometheus, begun_at, time.time(), options.out))


def play(port: int, characters: int, seconds: int, folder: Path) -> subprocess.Popen[bytes]:
    """Start a mixed scenario on a server; its own figures are not used."""
    command = [
        *(sys.executable, "-m", "motiongen_tools", "bench", "--server", f"localhost:{port}", "--scenario", "mixed"),
        *("--characters", str(characters), "--seconds", str(seconds), "--seed", "1", "--processes", "1"),
        *("--max-lag-ms", "100000", "--out", str(folder / f"load-{port}")),
    ]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def draw(prometheus: Prometheus, start: float, end: float, path: Path) -> Path:
    """Draw all panels in their places. Returns the picture's path."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = list(panels())
    height = max(panel.place[1] + panel.place[3] for panel in shown)
    figure = plt.figure(figsize=(24 * COLUMN * 2, height * LINE), facecolor="#111217")
    for panel in shown:
        x, y, width, tall = panel.place
        axes = figure.add_axes(
            (x / 24 + 0.035, 1 - (y + tall - 1.9) / height, width / 24 - 0.05, (tall - 3.2) / height)
        )
        draw_panel(axes, panel, prometheus, start, end)
    figure.savefig(path, dpi=70, facecolor=figure.get_facecolor())
    plt.close(figure)
    return path


def draw_panel(axes: Any, panel: Panel, prometheus: Prometheus, start: float, end: float) -> None:
    """Draw the series of a panel's queries over time, in seconds from the start."""
    axes.set_facecolor("#181b1f")
    axes.set_title(f"{panel.title}  [{panel.unit}]", color="white", fontsize=8, loc="left")
    axes.tick_params(colors="0.6", labelsize=6)
    for query in panel.queries:
        for series in prometheus.query_range(query.filled("15s"), start, end, STEP_S):
            moments, values = zip(*((at - start, float(value)) for at, value in series["values"]), strict=True)
            label = re.sub(r"{{(\w+)}}", lambda name, of=series: of["metric"].get(name[1], ""), query.legend)
            axes.plot(moments, values, lw=1, label=label)
    if panel.limit is not None:
        axes.axhline(panel.limit, color="#e02f44", lw=0.7, ls="--")
    axes.set_ylim(0, 1.25 * axes.get_ylim()[1])
    axes.set_xlim(0, end - start)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=5, labelcolor="0.8", facecolor="#181b1f", edgecolor="#181b1f", ncol=3, loc="upper left")
    else:
        axes.text(0.5, 0.5, "none yet", color="0.5", fontsize=8, ha="center", transform=axes.transAxes)


if __name__ == "__main__":
    main()
