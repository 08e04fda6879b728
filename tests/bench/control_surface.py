"""How precisely the served model meets each target of the contract: `python -m tests.bench.control_surface --server …`.

There is a row for each target: clips of some seeds for each of three prompts, or fewer for paths and far places, are
requested with this target alone. The table shows the server's residuals, which are what a client gets.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from motiongen_client import (
    Flexible,
    FootContact,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Motion,
    MotionClient,
    Residual,
    RootPath,
    RootTrajectory,
    SessionOptions,
    Waypoint,
)
from motiongen_client.types import Constraint

STAND, WALK, WAVE = "a person stands still", "a person walks forward", "a person waves with the right hand"
PROMPTS = (STAND, WALK, WAVE)
FRAMES = 200
Make = Callable[[Motion, Motion], Constraint]
"""Makes a constraint from the motion that the character would make without it, and from another clip of the prompt."""


@dataclass(frozen=True)
class Row:
    """One target. frames: the length of its clips."""

    name: str
    make: Make
    frames: int = 60
    prompts: Sequence[str] = PROMPTS


def rows(frame: int) -> list[Row]:
    """Every target of the contract; targets of a single frame are at `frame`."""
    return [
        Row("waypoint at a frame, 0.5 m aside", lambda own, _: Waypoint(frame, *near(own, frame, 0.5))),
        Row(
            "waypoint with heading, 0.5 m and 45 degrees",
            lambda own, _: Waypoint(frame, *near(own, frame, 0.5), math.pi / 4),
        ),
        Row(
            "waypoint in a window of 2 s, 1 m aside",
            lambda own, _: Flexible(Waypoint(frame, *near(own, frame, 1.0)), frame + 40),
            100,
        ),
        Row(
            "go there, 3 m to the left and 3 m ahead",
            lambda own, _: Flexible(Waypoint(0, 3.0, 3.0), at_any_frame=True, is_relative=True),
            FRAMES,
            (STAND, WALK),
        ),
        Row(
            "go there, 8 m ahead", lambda own, _: Flexible(Waypoint(0, 0.0, 8.0), at_any_frame=True), 240, (STAND, WALK)
        ),
        Row(
            "go there, 4 m behind, and turn round",
            lambda own, _: Flexible(Waypoint(0, 0.0, -4.0, 0.0), at_any_frame=True),
            FRAMES,
            (STAND, WALK),
        ),
        Row(
            "path of three corners at 1.2 m/s",
            lambda own, _: RootPath([[0.0, 3.0], [2.0, 4.0], [2.0, 7.0]]),
            FRAMES,
            (STAND, WALK),
        ),
        Row(
            "path of three corners at 2.5 m/s",
            lambda own, _: RootPath([[0.0, 4.0], [4.0, 6.0], [4.0, 10.0]], 2.5, 1.0),
            FRAMES,
            ("a person runs",),
        ),
        Row("trajectory of another clip of the prompt", trajectory(frame)),
        Row("heading alone, 45 degrees", lambda own, _: HeadingTarget(frame, math.pi / 4)),
        Row(
            "heading alone, 90 degrees to the left of the character",
            lambda own, _: Flexible(HeadingTarget(frame, math.pi / 2), is_relative=True),
        ),
        Row("head turned alone, 30 degrees", head(frame)),
        Row("keyframe of another clip of the prompt", lambda own, other: Keyframe(frame, pose(own, other, frame))),
        Row("root and right hand", joints(frame, ("Hips", "RightHand"))),
        Row("right hand, its root free", joints(frame, ("RightHand",))),
        Row("both feet, their root free", joints(frame, ("LeftFoot", "RightFoot"))),
        Row("left foot stands where another clip of the prompt has it", foot(frame)),
        Row("left foot stands there, turned by 20 degrees", foot(frame, math.radians(20))),
        Row("root 0.15 m lower, where it would be", height(frame, -0.15)),
        Row(
            "right hand 2 m to the left, its root free",
            lambda own, _: JointTargets(frame, [joint(own, "RightHand")], [[2.0, 1.2, 0.5]]),
        ),
    ]


def near(own: Motion, frame: int, metres: float) -> tuple[float, float]:
    x, _, z = own.root_translation_m[frame]
    return float(x) + metres, float(z)


def joint(own: Motion, name: str) -> int:
    return own.rig.joint_names.index(name)


def pose(own: Motion, other: Motion, frame: int) -> np.ndarray:
    """The other motion's pose (J, 3), moved to where the character would be."""
    shift = (own.root_translation_m[frame] - other.root_translation_m[frame]) * np.array([1, 0, 1], np.float32)
    return np.asarray(other.frame(frame).joint_positions_m() + shift, np.float32)


def trajectory(frame: int) -> Make:
    def make(own: Motion, other: Motion) -> Constraint:
        ground = other.root_translation_m[:, [0, 2]]
        return RootTrajectory(8, ground[8 : frame + 1] - ground[7] + own.root_translation_m[7, [0, 2]])

    return make


def head(frame: int) -> Make:
    turn = [[math.cos(math.pi / 12), 0.0, math.sin(math.pi / 12), 0.0]]
    return lambda own, _: JointRotations(frame, [joint(own, "Head")], turn)


def joints(frame: int, names: Sequence[str]) -> Make:
    def make(own: Motion, other: Motion) -> Constraint:
        indices = [joint(own, name) for name in names]
        return JointTargets(frame, indices, pose(own, other, frame)[indices])

    return make


def foot(frame: int, heading: float | None = None) -> Make:
    """The foot where the other clip has it, relative to the root."""

    def make(own: Motion, other: Motion) -> Constraint:
        x, _, z = pose(own, other, frame)[joint(own, "LeftFoot")]
        return FootContact(frame, "LeftFoot", float(x), float(z), heading)

    return make


def height(frame: int, metres: float) -> Make:
    def make(own: Motion, _: Motion) -> Constraint:
        return JointTargets(frame, [0], [own.root_translation_m[frame] + [0.0, metres, 0.0]])

    return make


async def measure(address: str, steps: int | None, frame: int, samples: int, only: str) -> list[str]:
    """The rows of a table."""
    table = ["| target | position m, mean (worst) | angle rad, mean (worst) | met |", "|---|---|---|---|"]
    async with MotionClient(address) as client:

        async def motion(
            prompt: str, seed: int, frames: int, *constraints: Constraint
        ) -> tuple[Motion, Residual | None]:
            options = SessionOptions(seed=seed, denoise_steps=steps)
            (clip,) = await client.generate_clip(prompt, num_frames=frames, options=options, constraints=constraints)
            return clip.motion, clip.residuals[0] if clip.residuals else None

        free: dict[tuple[str, int], Motion] = {}
        for row in rows(frame):
            if only not in row.name:
                continue
            residuals = []
            for prompt in row.prompts:
                for seed in (*range(1, samples + 1), 100):
                    if (prompt, seed) not in free:
                        free[prompt, seed] = (await motion(prompt, seed, 60))[0]
                for seed in range(1, samples + 1):
                    target = row.make(free[prompt, seed], free[prompt, 100])
                    residual = (await motion(prompt, seed, row.frames, target))[1]
                    assert residual is not None
                    residuals.append(residual)
            table.append(residual_row(row.name, residuals))
    return table


def residual_row(name: str, residuals: Sequence[Residual]) -> str:
    """Mean and worst deviation in metres and in radians, and how many targets were met."""
    positions = [each.position_m.worst for each in residuals if each.position_m is not None]
    angles = [angle.worst for each in residuals for angle in (each.heading_rad, each.rotation_rad) if angle is not None]
    return target_row(name, positions, angles, [each.met for each in residuals])


def target_row(name: str, positions_m: Sequence[float], angles_rad: Sequence[float], met: Sequence[bool]) -> str:
    """The same row, from given deviations."""
    return f"| {name} | {_cell(positions_m)} | {_cell(angles_rad)} | {sum(met)} of {len(met)} |"


def _cell(numbers: Sequence[float]) -> str:
    return f"{np.mean(numbers):.3f} ({max(numbers):.3f})" if numbers else "-"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.control_surface",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--server", required=True, help="HOST:PORT of a server")
    parser.add_argument("--denoise-steps", type=int, help="of each window (default: the model's own number)")
    parser.add_argument("--frame", type=int, default=36, help="of single-frame targets, below 60; 40 begins a window")
    parser.add_argument("--samples", type=int, default=2, help="clips of each prompt")
    parser.add_argument("--only", default="", help="only rows whose name contains this")
    options = parser.parse_args()
    table = measure(options.server, options.denoise_steps, options.frame, options.samples, options.only)
    print("\n".join(asyncio.run(table)))


if __name__ == "__main__":
    main()
