"""Waypoints within the horizon and beyond it, on the clip's way and off it; with, without and against a prompt."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.evaluate.cases import HISTORY, MOVING, Case
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.measures.root import travel_angle
from motiongen_ardy.evaluate.take import Result, Take, direction

FAMILY = "waypoint"
AHEAD_S = 2.0
BEYOND_S = (2.5, 4.0, 6.0)
TURNS = (30, 60, 90, 180)
MAX_SPEED_M_S = 1.2
# What is reachable is calculated for people who walk: a runner has to slow down first.
WALKING_M_S = 2.0


def reach(seconds: float, turn_deg: float) -> float:
    """How far away, in metres, a waypoint may be to be reachable in that time, turning included."""
    return MAX_SPEED_M_S * (seconds - abs(turn_deg) / 180)


def contradiction(case: Case) -> str:
    """A prompt that the waypoint contradicts."""
    return "a person stands still" if case.group == MOVING else "a person waves with the right hand"


def way(case: Case, context: Context) -> tuple[float, float]:
    """Direction (radians) and speed (m/s) of a case at its last history frame; if it stands, the direction it faces."""
    root = case.motion.root[:HISTORY]
    speed = float((root[-1] - root[-9]).norm()) / 8 * context.fps
    if case.group == MOVING and speed > 0.2:
        return travel_angle(root), speed
    return float(case.motion.facing(context.skeleton)[HISTORY - 1]), 0.7 * MAX_SPEED_M_S


def waypoint_take(context: Context, case: Case, name: str, seed: int, *, goal: Tensor, frame: int, prompt: str) -> Take:
    """A take that continues a case to a ground position (2) at a frame."""
    targets = Targets(context.skeleton)
    targets.add_waypoints([frame], goal[None].float())
    return Take(f"{case.id} {name}", seed, frame + 1, ((0, prompt),), case.group, case.history, targets)


def miss(result: Result) -> float:
    """Metres between the root and its last ground target at that target's frame."""
    assert result.take.targets is not None
    frame = max(result.take.targets.ground)
    return float((result.root[frame] - torch.from_numpy(result.take.targets.ground[frame])).norm())


def add(context: Context) -> None:
    """Add all rows about waypoints."""
    _in_horizon(context)
    _beyond(context)


def _in_horizon(context: Context) -> None:
    frame = HISTORY - 1 + context.frames(AHEAD_S)
    takes: dict[str, list[Take]] = {}
    for number, case in enumerate(context.both(frame + 1)):
        goal = case.motion.root[frame]
        angle, speed = way(case, context)
        aside = _off_the_way(float(goal.norm()), angle, number) if speed <= WALKING_M_S else []
        for seed in context.seeds:
            prompts = {"": case.caption, ", no prompt": "", ", contradicting prompt": contradiction(case)}
            for name, prompt in prompts.items():
                row = f"{AHEAD_S:g} s, on the way{name}"
                take = waypoint_take(context, case, row, seed, goal=goal, frame=frame, prompt=prompt)
                takes.setdefault(row, []).append(take)
            for row, place in aside:
                take = waypoint_take(context, case, row, seed, goal=place, frame=frame, prompt=case.caption)
                takes.setdefault(row, []).append(take)
    results = _run(context, takes)
    for row, group in results.items():
        if "the way" in row:
            context.add_goal(FAMILY, row, "m", group, miss, bound="waypoint on")
    off = {row: group for row, group in results.items() if "the way" not in row}
    context.add_goal(
        FAMILY,
        f"{AHEAD_S:g} s, off the way, all",
        "m",
        [one for group in off.values() for one in group],
        miss,
        bound="waypoint off",
    )
    for row, group in off.items():
        context.add_goal(FAMILY, row, "m", group, miss, bound="waypoint off")
    _show(context, results)


def _off_the_way(distance: float, angle: float, number: int) -> list[tuple[str, Tensor]]:
    """Rows and places for a clip whose own way is `distance` metres long; sides alternate from clip to clip."""
    places = []
    for turn in TURNS:
        side = 1 if (number + turn // 30) % 2 else -1
        far = min(max(distance, 0.3), reach(AHEAD_S, turn))
        places.append((f"{AHEAD_S:g} s, turned {turn} degrees", far * direction(angle + side * math.radians(turn))))
    near = min(0.5 * distance, reach(AHEAD_S, 0))
    places.append((f"{AHEAD_S:g} s, nearer", near * direction(angle)))
    far = min(max(1.5 * distance, 0.5), max(reach(AHEAD_S, 0), distance))
    places.append((f"{AHEAD_S:g} s, farther", far * direction(angle)))
    return places


def _beyond(context: Context) -> None:
    takes: dict[str, list[Take]] = {}
    last = HISTORY - 1 + context.frames(BEYOND_S[-1])
    cases = [case for case in context.both(HISTORY + 20) if way(case, context)[1] <= WALKING_M_S]
    for seconds in BEYOND_S:
        frame = HISTORY - 1 + context.frames(seconds)
        for number, case in enumerate(cases):
            angle, speed = way(case, context)
            turn = (45, 90, 180)[number % 3] * (1 if number % 2 else -1)
            ahead = min(speed * seconds, reach(seconds, 0))
            own = case.motion.root[frame] if frame < case.num_frames and frame < last else ahead * direction(angle)
            if case.group != MOVING or float(own.norm()) > reach(seconds, 0):
                own = ahead * direction(angle)
            aside = min(speed * seconds, reach(seconds, turn)) * direction(angle + math.radians(turn))
            for seed in context.seeds:
                rows = {
                    f"{seconds:g} s, on the way": (own, case.caption),
                    f"{seconds:g} s, off the way": (aside, case.caption),
                }
                if seconds == BEYOND_S[1]:
                    rows[f"{seconds:g} s, no prompt"] = (aside if number % 2 else own, "")
                    rows[f"{seconds:g} s, contradicting prompt"] = (aside if number % 2 else own, contradiction(case))
                for row, (goal, prompt) in rows.items():
                    take = waypoint_take(context, case, row, seed, goal=goal, frame=frame, prompt=prompt)
                    takes.setdefault(row, []).append(take)
    results = _run(context, takes)
    fitting = [one for row, group in results.items() if row.endswith("way") for one in group]
    context.add_goal(FAMILY, "2.5 to 6 s, all", "m", fitting, miss, bound="waypoint beyond")
    for row, group in results.items():
        context.add_goal(FAMILY, row, "m", group, miss, bound="waypoint beyond")
    _show(context, results)


def _run(context: Context, takes: dict[str, list[Take]]) -> dict[str, list[Result]]:
    results = iter(context.run([take for group in takes.values() for take in group]))
    return {row: [next(results) for _ in group] for row, group in takes.items()}


def _show(context: Context, results: dict[str, list[Result]]) -> None:
    for row, group in results.items():
        context.show(FAMILY, [Exhibit(f"{row}: {miss(group[0]):.2f} m off", group[0], _goals(group[0]))])


def _goals(result: Result) -> tuple[tuple[int, float, float], ...]:
    targets = result.take.targets
    return () if targets is None else tuple((frame, *place.tolist()) for frame, place in targets.ground.items())
