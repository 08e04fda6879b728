"""Velocity: speeds from standing and walking, U-turns, and prompts that stand, wave or walk."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.measures.root import ground_velocity, smoothed, turn_rate, turned
from motiongen_ardy.evaluate.take import Result, Steer, Take, result_frames

FAMILY = "velocity"
SPEEDS_M_S = (0.5, 1.0, 1.5, 2.0, 3.0)
U_TURNS_M_S = (1.2, 2.0, 3.0)
LEAD_S = 2.4
STAND, WALK, WAVE = "a person stands still", "a person walks forward", "a person waves with the right hand"


def grace_s(speed: float) -> float:
    """The time that a character has to reach a speed, in seconds."""
    return 1.0 if speed <= 1.5 else 2.0


def add(context: Context) -> None:
    """Add all rows about velocity: sessions of 2.4 s under a prompt alone, then steered."""
    lead = context.frames(LEAD_S)
    takes: dict[str, list[Take]] = {}
    meaning: dict[str, float] = {}
    for lead_name, prompt in (("standing", STAND), ("walking", WALK)):
        for speed in SPEEDS_M_S:
            row = f"{speed:g} m/s from {lead_name}"
            meaning[row] = speed
            takes[row] = [_take(context, row, seed, prompt, prompt, speed) for seed in _sessions(context)]
    for name, prompt in (("stands", STAND), ("waves", WAVE), ("walks", WALK)):
        row = f'1.2 m/s under "{name}"'
        meaning[row] = 1.2
        takes[row] = [_take(context, row, seed, prompt, prompt, 1.2) for seed in _sessions(context)]
    results = iter(context.run([take for group in takes.values() for take in group]))
    for row, group in takes.items():
        done = [next(results) for _ in group]
        speed, standing = meaning[row], "walking" not in row and "walks" not in row
        first = lead + context.frames(grace_s(speed))
        reached = _reached(speed, first, context.fps)
        title = f"{row}: share of it reached after {grace_s(speed):g} s"
        context.add_goal(FAMILY, title, "", done, reached, bound="speed", from_standing=standing, first=lead)
        context.add_goal(FAMILY, f"{row}: to 90 %", "s", done, _time_to(speed, lead, context.fps), first=lead)
        context.show(FAMILY, [Exhibit(f"{row}: reached {reached(done[0]):.2f} of it", done[0])])
    for speed in U_TURNS_M_S:
        _u_turn(context, speed)


def _sessions(context: Context) -> range:
    return range(max(2, context.size.sessions // 2))


def _take(context: Context, row: str, seed: int, before: str, during: str, speed: float) -> Take:
    lead = context.frames(LEAD_S)
    prompts = ((0, before),) if before == during else ((0, before), (lead, during))
    end = lead + context.frames(grace_s(speed) + 1.5)
    return Take(row, seed, end, prompts, steers=(Steer(lead, 0.0, speed),))


def along(result: Result, fps: int) -> Tensor:
    """(T-1) metres a second in the direction of the last velocity asked for, smoothed over 0.45 s."""
    steer = result.take.steers[-1]
    asked = torch.tensor([steer.x, steer.z])
    return smoothed(ground_velocity(result.root, fps), 9) @ (asked / asked.norm())


def _reached(speed: float, first: int, fps: int) -> Callable[[Result], float]:
    """A measure of the mean speed over the second from frame `first` on, as a share of what was asked for."""

    def measure(result: Result) -> float:
        return float(along(result, fps)[first : first + fps].mean()) / speed

    return measure


def _time_to(speed: float, lead: int, fps: int) -> Callable[[Result], float]:
    """A measure of the seconds from frame `lead` to 90 % of the speed; to the end if that is not reached."""

    def measure(result: Result) -> float:
        there = (along(result, fps)[lead:] >= 0.9 * speed).nonzero()[:, 0]
        return (float(there[0]) if len(there) else result.take.num_frames - lead) / fps

    return measure


def _u_turn(context: Context, speed: float) -> None:
    """A velocity that is reversed from ahead to back."""
    lead, turn = context.frames(LEAD_S), context.frames(LEAD_S + 3)
    end = turn + context.frames(4)
    takes = [
        Take("U-turn", seed, end, ((0, WALK),), steers=(Steer(lead, 0.0, speed), Steer(turn, 0.0, -speed)))
        for seed in _sessions(context)
    ]
    results = context.run(takes)

    def hips_rad_s(result: Result) -> float:
        return float(turn_rate(result.facing(context.skeleton)[turn:], context.fps, width=1).abs().max())

    def backwards(result: Result) -> float:
        velocity = smoothed(ground_velocity(result.root, context.fps), 9)[turn:]
        facing = result.facing(context.skeleton)[turn:-1]
        angle = turned(torch.atan2(velocity[:, 0], velocity[:, 1]), facing).abs()
        return float(((velocity.norm(dim=-1) > 0.3) & (angle > math.radians(100))).sum())

    row = f"U-turn at {speed:g} m/s"
    context.add_goal(FAMILY, f"{row}: to 90 %", "s", results, _time_to(speed, turn, context.fps), first=turn)
    context.add_goal(FAMILY, f"{row}: walked backwards", "frames", results, backwards, first=turn)
    context.add_goal(FAMILY, f"{row}: hips turn at most", "rad/s", results, hips_rad_s, bound="hips", first=turn)
    worst = max(results, key=hips_rad_s)
    title = f"{row}: {backwards(worst):.0f} frames backwards, hips at up to {hips_rad_s(worst):.1f} rad/s"
    context.show(FAMILY, [Exhibit(title, result_frames(worst, turn - context.fps))])
