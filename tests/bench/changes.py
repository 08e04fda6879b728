"""How abrupt motion is where it changes: `python -m tests.bench.changes [--seeds 6] [--only "goto near"]`.

Characters of the built-in model are played through gRPC, faster than real time, and get another order after a while:
gestures, gaits, stops, turns of the stick, short distances. Reported for each: the hardest acceleration of any joint
relative to the root and the fastest turn of the hips from one frame to the next, with seed and frame. Percentiles would
hide these. When an edit takes effect depends on when it arrives, so figures of two runs differ a little.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motiongen_client import MotionClient, Session, SessionOptions, StartPose
from motiongen_tools.server_process import ServerProcess

SETTINGS = (
    "--devices", "cpu:1", "--profile-s", "0.3", "--admit-load", "1000", "--degrade", "false",
    "--playback-rate", "1000", "--events-per-second", "1000",
)  # fmt: skip
FPS, AT_ONCE = 20, 24
AHEAD_RAD, BEFORE_S, AFTER_S, HOLD_S = math.pi / 2, 2.5, 4.0, 20.0
STAND, WALK, JOG, RUN = "a person stands still", "a person walks forward", "a person jogs", "a person runs forward"
SPRINT, BACK = "a person sprints", "a person walks backward"
GESTURES = ("a person waves with both hands", "a person raises both hands", "a person raises the left hand")
GAITS = ((1.2, WALK), (2.0, JOG), (3.0, RUN))


@dataclass(frozen=True)
class Order:
    """What a character is told: a prompt, a velocity in m/s, a place in metres relative to the root, a heading."""

    prompt: str | None = None
    velocity: tuple[float, float] | None = None
    place: tuple[float, float] | None = None
    heading: float | None = None


@dataclass(frozen=True)
class Figures:
    """One character's hardest acceleration, m/s2, and fastest turn of the hips, rad/s, each with its frame."""

    seed: int
    hardest: float
    hardest_at: int
    hips: float
    hips_at: int


def changes() -> dict[str, tuple[Order, Order]]:
    """The first and the second order of each change, by the name of its row."""
    told: dict[str, tuple[Order, Order]] = {}
    for before, after in ((RUN, STAND), (SPRINT, STAND), (WALK, STAND), (STAND, SPRINT), (WALK, BACK), (RUN, BACK)):
        told[f"{before} > {after}"] = Order(before), Order(after)
    for gesture in GESTURES:
        for gait in (WALK, RUN):
            told[f"{gesture} > {gait}"] = Order(gesture), Order(gait)
            told[f"{gait} > {gesture}"] = Order(gait), Order(gesture)
    for speed, prompt in GAITS:
        goes = Order(prompt, (speed, 0.0))
        told[f"{speed} m/s > stop"] = goes, Order(velocity=(0.0, 0.0))
        told[f"stands > {speed} m/s"] = Order(STAND), Order(velocity=(speed, 0.0))
        told[f"{speed} m/s > 0.5 m/s"] = goes, Order(velocity=(0.5, 0.0))
        told[f"{speed} m/s > sideways"] = goes, Order(velocity=(0.0, 1.0), heading=AHEAD_RAD)
        told[f"{speed} m/s > backwards"] = goes, Order(velocity=(-1.0, 0.0), heading=AHEAD_RAD)
        for degrees in (45, 90, 135, 180):
            turned = math.radians(degrees)
            way = speed * math.cos(turned), speed * math.sin(turned)
            told[f"{speed} m/s, turned {degrees} degrees"] = goes, Order(velocity=way)
        told[f"{speed} m/s > 6 m back"] = goes, Order(place=(-6.0, 0.0))
    for name, place, heading in (
        ("goto near", (0.5, 0.3), None), ("goto near behind", (-0.4, 0.0), None), ("goto aside", (0.0, 2.0), None),
        ("goto behind", (-2.0, 0.0), None), ("turn in place", (0.0, 0.05), -AHEAD_RAD),
        ("goto and face aside", (2.0, 0.0), 0.0),
    ):  # fmt: skip
        told[name] = Order(STAND), Order(place=place, heading=heading)
    return told


async def tell(session: Session, order: Order, root: tuple[float, float]) -> None:
    """Give an order to a character whose root is at x and z."""
    if order.prompt is not None:
        await session.set_prompt(order.prompt)
    if order.velocity is not None:
        await session.set_velocity(*order.velocity, seconds=HOLD_S, heading_rad=order.heading)
    if order.place is not None:
        await session.go_to(root[0] + order.place[0], root[1] + order.place[1], heading_rad=order.heading)


async def played(client: MotionClient, orders: tuple[Order, Order], seed: int) -> np.ndarray:
    """(T, J, 3) metres of a character that gets the second order after a while, a little later with each seed."""
    options = SessionOptions(seed=seed, start=StartPose(0.0, 0.0, AHEAD_RAD), lookahead_frames=40)
    made: list[np.ndarray] = []
    async with await client.open("a person stands", options=options) as session:
        for order, seconds in zip(orders, (BEFORE_S + 0.35 * seed, AFTER_S), strict=True):
            x, _, z = made[-1][0].tolist() if made else (0.0, 0.0, 0.0)
            await tell(session, order, (x, z))
            async for frame in session.frames(seconds, realtime=False):
                made.append(frame.joint_positions_m().astype(np.float64))
    return np.array(made)


def hardest_m_s2(joints_m: np.ndarray) -> np.ndarray:
    """The highest acceleration of any joint relative to the root's ground position, without first and last frame."""
    beside = joints_m - joints_m[:, :1] * np.array([1.0, 0.0, 1.0])
    hardest: np.ndarray = np.linalg.norm(np.diff(beside, 2, axis=0), axis=-1).max(axis=1) * FPS**2
    return hardest


def hips_rad_s(joints_m: np.ndarray, hips: tuple[int, int]) -> np.ndarray:
    """How fast the line between the hips turns about the up axis, frame by frame."""
    line = joints_m[:, hips[0]] - joints_m[:, hips[1]]
    return np.abs(np.diff(np.unwrap(np.arctan2(line[:, 0], line[:, 2])))) * FPS


def measured(joints_m: np.ndarray, hips: tuple[int, int], seed: int) -> Figures:
    """The figures of positions (T, J, 3), without the first second."""
    hardest, turns = hardest_m_s2(joints_m)[FPS:], hips_rad_s(joints_m, hips)[FPS:]
    at, turned_at = int(hardest.argmax()), int(turns.argmax())
    return Figures(seed, float(hardest[at]), at + FPS + 1, float(turns[turned_at]), turned_at + FPS + 1)


async def run(told: Mapping[str, tuple[Order, Order]], seeds: int) -> dict[str, list[Figures]]:
    """The figures of all seeds of each change, measured on one server."""
    free = asyncio.Semaphore(AT_ONCE)
    with ServerProcess(SETTINGS) as server:
        async with MotionClient(server.address) as client:
            names = list(client.catalog.rig(client.catalog.models[0].rig_id).joint_names)
            hips = names.index("RightUpLeg"), names.index("LeftUpLeg")

            async def one(name: str, seed: int) -> tuple[str, Figures]:
                async with free:
                    return name, measured(await played(client, told[name], seed), hips, seed)

            done = await asyncio.gather(*(one(name, seed) for name in told for seed in range(seeds)))
    return {name: [figures for other, figures in done if other == name] for name in told}


def table(rows: Mapping[str, Sequence[Figures]]) -> str:
    """A Markdown table, the hardest change first, and a line about all changes."""
    lines = ["| change | hardest, m/s2: median | worst | seed, frame | hips, rad/s: worst | seed, frame |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    for name, figures in sorted(rows.items(), key=lambda row: -max(one.hardest for one in row[1])):
        worst, fastest = max(figures, key=lambda one: one.hardest), max(figures, key=lambda one: one.hips)
        median = float(np.median([one.hardest for one in figures]))
        lines.append(
            f"| {name} | {median:.0f} | {worst.hardest:.0f} | {worst.seed}, {worst.hardest_at} "
            f"| {fastest.hips:.1f} | {fastest.seed}, {fastest.hips_at} |"
        )
    hardest = np.array([one.hardest for figures in rows.values() for one in figures])
    lines.append(f"\n{len(hardest)} characters: median {np.median(hardest):.0f}, worst {hardest.max():.0f}")
    lines.append(f"harder than 100: {int((hardest > 100).sum())}, than 80: {int((hardest > 80).sum())}")
    return "\n".join(lines)


def main() -> None:
    """Command line."""
    told = changes()
    parser = argparse.ArgumentParser(prog="python -m tests.bench.changes", description=__doc__)
    parser.add_argument("--seeds", type=int, default=6, help="seeds of each change (default %(default)s)")
    parser.add_argument("--only", choices=sorted(told), metavar="CHANGE", help="measure this change alone")
    arguments = parser.parse_args()
    chosen = told if arguments.only is None else {arguments.only: told[arguments.only]}
    print(table(asyncio.run(run(chosen, arguments.seeds))))


if __name__ == "__main__":
    main()
