"""How precisely playing characters meet the targets they get: `python -m tests.bench.live_surface --server …`.

While `control_surface` asks for clips, here sessions play in real time: each gets its target after it has walked, or
stood, for a second, and the server reports the result (ConstraintReached). This covers what clips do not: windows that
are replanned while the character moves, places relative to where it is then, frames that are committed already. All
sessions of a row play at once, on one stream.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from motiongen_client import (
    ConstraintReached,
    Flexible,
    HeadingTarget,
    JointTargets,
    MotionClient,
    RootPath,
    RootTrajectory,
    Session,
    SessionOptions,
    Waypoint,
)
from motiongen_client.types import Constraint
from tests.bench.control_surface import target_row

STAND, WALK, RUN = "a person stands still", "a person walks forward", "a person runs"


@dataclass(frozen=True)
class Row:
    """One target, given to a session after a second of playback."""

    name: str
    make: Callable[[Session], Constraint]
    prompts: Sequence[str] = (STAND, WALK)


def corners(session: Session, *points: tuple[float, float]) -> list[list[float]]:
    """World coordinates of corners that are given relative to the character, along the world's axes."""
    x, _, z = session.motion().root_translation_m[-1]
    return [[float(x) + right, float(z) + ahead] for right, ahead in points]


def straight(session: Session) -> Constraint:
    """A trajectory of two seconds that begins in a second and continues the velocity of the last half second."""
    ground = session.motion().root_translation_m[:, [0, 2]]
    pace = (ground[-1] - ground[-11]) / 10
    first = session.frame_in(1.0)
    frames = np.arange(first, first + session.rig.frames_in(2.0)) - session.playback.playhead
    return RootTrajectory(first, ground[-1] + frames[:, None] * pace)


ROWS = (
    Row(
        "path of three corners at 1.2 m/s",
        lambda session: RootPath(corners(session, (0.0, 3.0), (2.0, 4.0), (2.0, 7.0))),
    ),
    Row(
        "path of three corners at 2.5 m/s",
        lambda session: RootPath(corners(session, (0.0, 4.0), (4.0, 6.0), (4.0, 10.0)), 2.5, 1.0),
        (RUN,),
    ),
    Row("path of 2.3 m from a stand", lambda session: RootPath(corners(session, (0.0, 2.3))), (STAND,)),
    Row("trajectory of 2 s straight on from in 1 s, as it walks", straight, (WALK,)),
    Row(
        "go there, 3 m to the left and 3 m ahead",
        lambda _: Flexible(Waypoint(0, 3.0, 3.0), at_any_frame=True, is_relative=True),
    ),
    Row(
        "go there, 4 m behind, and turn round",
        lambda _: Flexible(Waypoint(0, 0.0, -4.0, math.pi), at_any_frame=True, is_relative=True),
    ),
    Row(
        "waypoint in a window of 2 s, 1 m to the left and 2 m ahead",
        lambda session: Flexible(Waypoint(session.frame_in(2.0), 1.0, 2.0), session.frame_in(4.0), is_relative=True),
    ),
    Row(
        "heading alone in 2 s, 90 degrees to the left",
        lambda session: Flexible(HeadingTarget(session.frame_in(2.0), math.pi / 2), is_relative=True),
    ),
    Row(
        "right hand in 2 s, up to the right and ahead, its root free",
        lambda session: Flexible(
            JointTargets(session.frame_in(2.0), [session.rig.joint_names.index("RightHand")], [[-0.3, 1.4, 0.3]]),
            is_relative=True,
        ),
        (STAND,),
    ),
)


async def played(client: MotionClient, row: Row, prompt: str, seed: int, steps: int | None) -> ConstraintReached:
    """The result of the row's target in one session."""
    options = SessionOptions(seed=seed, denoise_steps=steps)
    told: asyncio.Task[ConstraintReached] | None = None
    async with await client.open(prompt, options=options) as session:
        async for frame in session.frames():
            if told is None and frame.index >= session.rig.frames_in(1.0):
                told = asyncio.create_task(what_became(session, row.make(session)))
            if told is not None and told.done():
                return told.result()
    raise RuntimeError(f"the session of {row.name!r} ended before its target was answered")


async def what_became(session: Session, target: Constraint) -> ConstraintReached:
    edit = session.add_constraints([target])
    await edit
    return await session.constraint_reached(edit.constraint_ids[0])


async def measure(address: str, samples: int, steps: int | None, only: str) -> list[str]:
    """The rows of a table."""
    table = ["| told while it plays | position m, mean (worst) | angle rad, mean (worst) | met |", "|---|---|---|---|"]
    async with MotionClient(address) as client:
        for row in ROWS:
            if only not in row.name:
                continue
            asked = [(prompt, seed) for prompt in row.prompts for seed in range(1, samples + 1)]
            told = await asyncio.gather(*(played(client, row, prompt, seed, steps) for prompt, seed in asked))
            table.append(reached_row(row.name, told))
    return table


def reached_row(name: str, told: Sequence[ConstraintReached]) -> str:
    """Mean and worst deviation in metres and in radians, and how many targets were met."""
    positions = [each.position_error_m for each in told if each.position_error_m is not None]
    angles = [each.rotation_error_rad for each in told if each.rotation_error_rad is not None]
    return target_row(name, positions, angles, [each.met for each in told])


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.live_surface",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--server", required=True, help="HOST:PORT of a server")
    parser.add_argument("--samples", type=int, default=2, help="sessions of each prompt")
    parser.add_argument("--denoise-steps", type=int, help="of each window (default: the model's own number)")
    parser.add_argument("--only", default="", help="only rows whose name contains this")
    options = parser.parse_args()
    print("\n".join(asyncio.run(measure(options.server, options.samples, options.denoise_steps, options.only))))


if __name__ == "__main__":
    main()
