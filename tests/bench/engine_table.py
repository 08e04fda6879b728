"""The engine's table as text and as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tests.bench.contest import Standing
from tests.bench.engine_run import Ceiling, Report


def markdown(report: Report) -> str:
    """Tables of contestants and ceilings, and the machine they were measured on."""
    lines = []
    if report.standings:
        lines += [*standings(report.standings), ""]
    lines += [*ceilings(report.ceilings), ""]
    habits = report.habits
    lines += [
        f"- each character: {habits.num_steps} denoising steps, separated guidance; an edit every "
        f"{1 / habits.edits_hz:g} s, one in {habits.walkers} by waypoints, the others by prompts",
        f"- at most {report.settings.max_rows} rows a step; search trials of {report.settings.effort.measure_s:g} s "
        f"after {report.settings.effort.warm_up_s:g} s",
        *(["- time: this process's processor time, as on one core of its own"] * report.settings.processor_time),
        *(f"- {name}: {value}" for name, value in report.facts.items()),
        "",
    ]
    return "\n".join(lines)


def standings(found: tuple[Standing, ...]) -> list[str]:
    base = next((one.characters for one in found if one.name == "B0"), 0)
    lines = [
        "| engine | characters, < 1 % missed | against B0 | windows/s | rows a step | idle | full batches, windows/s "
        "| edit to frame at 70 %, p50 / p99 (edits) | cores taken by others |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for one in found:
        best = one.best
        windows, rows, idle, others = "-", "-", "-", "-"
        if best is not None:
            windows, rows, idle = f"{best.windows_per_s:.1f}", f"{best.rows:.1f}", f"{100 * best.idle:.0f} %"
            others = f"{100 * max(trial.others_share for trial in one.trials):.0f} %"
        half, most = one.latency_ms(50), one.latency_ms(99)
        latency = "-" if half is None or most is None else f"{half:.0f} / {most:.0f} ms"
        count = len(one.at_load.latencies_s) if one.at_load else 0
        against = f"{one.characters / base:.1f} x" if base else "-"
        lines.append(
            f"| {one.name}: {one.meaning} | {one.characters} | {against} | {windows} | {rows} | {idle} "
            f"| {one.offline_windows_per_s:.1f} | {latency} ({count}) | {others} |"
        )
    broken = sum(trial.broken for one in found for trial in one.trials)
    return [*lines, "", f"Plans that broke a promise, in all trials: {broken}."]


def ceilings(found: tuple[Ceiling, ...]) -> list[str]:
    lines = [
        "| full batches of | precision | batch | windows/s | characters | prepare / step / decode "
        "| GFLOP a window | matrix product | efficiency, step / window |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for one in found:
        rate = one.rate
        calls = " / ".join(f"{1000 * value:.1f}" for value in (rate.prepare_s, rate.step_s, rate.decode_s))
        lines.append(
            f"| {one.model} | {one.precision} | {rate.batch} | {rate.windows_per_s:.4g} | {2 * rate.windows_per_s:.4g} "
            f"| {calls} ms | {one.window_flops / 1e9:.2f} | {one.product_flops_per_s / 1e9:.0f} GFLOP/s "
            f"| {100 * one.step_efficiency:.0f} / {100 * one.efficiency:.0f} % |"
        )
    return lines


def as_json(report: Report) -> dict[str, Any]:
    """All measurements, and the figures derived from them."""
    found = asdict(report)
    for entry, ceiling in zip(found["ceilings"], report.ceilings, strict=True):
        entry |= {"windows_per_s": ceiling.rate.windows_per_s, "efficiency": ceiling.efficiency}
    for entry, standing in zip(found["standings"], report.standings, strict=True):
        entry |= {"edit_to_frame_ms": {"p50": standing.latency_ms(50), "p99": standing.latency_ms(99)}}
    return found


def write(report: Report, folder: Path) -> None:
    """Write engine.json and engine.md."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "engine.md").write_text(markdown(report), encoding="utf-8")
    (folder / "engine.json").write_text(json.dumps(as_json(report), indent=1) + "\n", encoding="utf-8")
