"""Dense paths (the clip's own, a circle, a right angle as clicked), headings fixed off the path, turns on the spot."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.evaluate.cases import HISTORY, MOVING, STANDING, Case
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.measures.feet import swivelled
from motiongen_ardy.evaluate.measures.root import turned
from motiongen_ardy.evaluate.rows.waypoints import way
from motiongen_ardy.evaluate.take import Result, Take, direction

SPEED_M_S = 1.1
CIRCLE_RADIUS_M = 2.0
WALK = "a person walks forward"


def path_take(
    context: Context, case: Case, name: str, seed: int, ground: Tensor, *, prompt: str, heading: Tensor | None = None
) -> Take:
    """A case whose ground position (K, 2), and optionally heading (K), is constrained at each following frame."""
    targets = Targets(context.skeleton)
    frames = range(HISTORY, HISTORY + len(ground))
    targets.add_waypoints(frames, ground.float(), None if heading is None else heading.float())
    history, end = case.history, HISTORY + len(ground)
    return Take(f"{case.id} {name}", seed, end, ((0, prompt),), case.group, history, targets)


def off_path(result: Result) -> float:
    """The mean distance in metres from where the path is at each of its frames."""
    assert result.take.targets is not None
    frames = sorted(result.take.targets.ground)
    asked = torch.from_numpy(np.array([result.take.targets.ground[frame] for frame in frames]))
    return float((result.root[frames] - asked).norm(dim=-1).mean())


def circle(angle: float, num_frames: int, fps: int, side: int) -> Tensor:
    """Ground positions (K, 2) along a circle from the origin, starting in a direction; side: 1 left, -1 right."""
    arc = torch.arange(1, num_frames + 1) * SPEED_M_S / fps / CIRCLE_RADIUS_M
    ahead, left = direction(angle), direction(angle + side * math.pi / 2)
    return CIRCLE_RADIUS_M * (arc.sin()[:, None] * ahead + (1 - arc.cos())[:, None] * left)


def right_angle(angle: float, num_frames: int, fps: int, side: int) -> Tensor:
    """Ground positions (K, 2): 2 m ahead and then aside, at constant speed through a sharp corner."""
    far = torch.arange(1, num_frames + 1) * SPEED_M_S / fps
    ahead, aside = direction(angle), direction(angle + side * math.pi / 2)
    return far.clamp(max=2.0)[:, None] * ahead + (far - 2.0).clamp(min=0.0)[:, None] * aside


def add(context: Context) -> None:
    """Add all rows about paths and headings."""
    _paths(context)
    _headings(context)
    _turns(context)


def walkers(context: Context, count: int | None = None) -> list[Case]:
    """Clips that walk straight on at their start."""
    return context.chosen(MOVING, HISTORY + 20, count, ("walk",)) or context.chosen(MOVING, HISTORY + 20, count)


def _paths(context: Context) -> None:
    takes: dict[str, list[Take]] = {"path clip": [], "path circle": [], "path angle": []}
    for case in context.both(HISTORY + 40):
        own = case.motion.root[HISTORY : HISTORY + 80]
        own = own[: len(own) // 4 * 4]
        takes["path clip"] += [
            path_take(context, case, "own", seed, own, prompt=case.caption) for seed in context.seeds
        ]
    for number, case in enumerate(walkers(context, context.size.sessions)):
        angle, _ = way(case, context)
        side = 1 if number % 2 else -1
        for seed in context.seeds:
            round_ = circle(angle, context.frames(6), context.fps, side)
            takes["path circle"].append(path_take(context, case, "circle", seed, round_, prompt=WALK))
            corner = right_angle(angle, context.frames(4), context.fps, side)
            takes["path angle"].append(path_take(context, case, "angle", seed, corner, prompt=WALK))
    titles = {"path clip": "clip's own", "path circle": "circle, radius 2 m", "path angle": "right angle as clicked"}
    results = iter(context.run([take for group in takes.values() for take in group]))
    for bound, group in takes.items():
        done = [next(results) for _ in group]
        context.add_goal("path", titles[bound], "m", done, off_path, bound=bound)
        for result in done[: 2 * len(context.seeds) : len(context.seeds)]:
            path = _asked(result)
            context.show("path", [Exhibit(f"{titles[bound]}: {off_path(result):.2f} m off", result, path=path)])


def _asked(result: Result) -> np.ndarray:
    assert result.take.targets is not None
    return np.array([place for _, place in sorted(result.take.targets.ground.items())])


def off_heading(context: Context, first: int) -> Callable[[Result], float]:
    """A measure of the mean angle in degrees between the hips' facing and the asked heading, from frame `first` on."""

    def measure(result: Result) -> float:
        assert result.take.targets is not None
        frames = sorted(frame for frame in result.take.targets.heading if frame >= first)
        cosine, sine = torch.from_numpy(np.array([result.take.targets.heading[frame] for frame in frames])).unbind(1)
        difference = turned(result.facing(context.skeleton)[frames], torch.atan2(sine, cosine))
        return math.degrees(float(difference.abs().mean()))

    return measure


def _headings(context: Context) -> None:
    """A straight walk with a heading fixed off the path; the first second is left for getting there."""
    takes: dict[int, list[Take]] = {0: [], 45: [], 90: []}
    count = context.frames(4)
    for number, case in enumerate(walkers(context, context.size.sessions)):
        angle, _ = way(case, context)
        ground = torch.arange(1, count + 1)[:, None] * 0.8 / context.fps * direction(angle)
        for off, group in takes.items():
            heading = torch.full((count,), angle + math.radians(off) * (1 if number % 2 else -1))
            group += [
                path_take(context, case, f"{off}", seed, ground, prompt=WALK, heading=heading) for seed in context.seeds
            ]
    results = iter(context.run([take for group in takes.values() for take in group]))
    measure = off_heading(context, HISTORY + context.fps)
    every: list[Result] = []
    for off, group in takes.items():
        done = [next(results) for _ in group]
        every += done
        context.add_goal("heading", f"{off} degrees off the way", "degrees", done, measure, bound="heading")
        for first in done[:1]:
            title = f"heading {off} off the way: {measure(first):.0f} degrees off"
            context.show("heading", [Exhibit(title, first, path=_asked(first))])
    context.add_goal("heading", "while moving, all: root", "m", every, off_path)


def _turns(context: Context) -> None:
    """Standing clips that are to stay in place and be turned a while later."""
    takes: dict[int, list[Take]] = {90: [], 180: []}
    for number, case in enumerate(context.chosen(STANDING, HISTORY + 8)):
        facing = float(case.motion.facing(context.skeleton)[HISTORY - 1])
        for off, group in takes.items():
            frame = HISTORY - 1 + context.frames(1.0 + off / 90)
            targets = Targets(context.skeleton)
            side = 1 if number % 2 else -1
            targets.add_waypoints([frame], torch.zeros(1, 2), torch.tensor([facing + side * math.radians(off)]))
            group += [
                Take(
                    f"{case.id} turn {off}",
                    seed,
                    frame + 1,
                    ((0, "a person stands still"),),
                    MOVING,
                    case.history,
                    targets,
                )
                for seed in context.seeds
            ]
    results = iter(context.run([take for group in takes.values() for take in group]))
    measure = off_heading(context, HISTORY)
    for off, group in takes.items():
        done = [next(results) for _ in group]
        row = f"turn on the spot by {off} in {1.0 + off / 90:g} s"
        context.add_goal("heading", row, "degrees", done, measure, bound="heading", from_standing=True)
        slid = f"turn on the spot by {off}: toes slide"
        context.add_goal(
            "heading",
            slid,
            "m",
            done,
            lambda one: swivelled(context.skeleton, one.positions[HISTORY - 1 :]),
            bound="glided",
            from_standing=True,
        )
        if done:
            context.show("heading", [Exhibit(f"{row}: {measure(done[0]):.0f} degrees off", done[0])])
