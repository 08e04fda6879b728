"""How near the served model comes to every kind of target: `python -m tests.bench.targets --server HOST:PORT`.

Clips of some seeds for each of three prompts; each has one target, which the server measures (its residuals).
Poses that are asked for are those of other clips of the same prompt, moved to where the character is.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Callable, Sequence

import numpy as np

from motiongen_client import (
    Clip,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Motion,
    MotionClient,
    Residual,
    SessionOptions,
    Waypoint,
)
from motiongen_client.types import Constraint
from tests.bench.residual_row import residual_row

PROMPTS = ("a person stands still", "a person walks forward", "a person waves with the right hand")
FRAMES = 60
Target = Callable[[Motion], Constraint]
"""Of the motion that the character would make without it."""


def targets(motion: Motion, frame: int) -> dict[str, Target]:
    """Targets at a frame, by name. motion: of another seed, whose poses are asked for."""
    rig = motion.rig
    hand, head = rig.joint_names.index("RightHand"), rig.joint_names.index("Head")

    def near(own: Motion, metres: float) -> tuple[float, float]:
        x, _, z = own.root_translation_m[frame]
        return float(x) + metres, float(z)

    def moved(own: Motion) -> np.ndarray:
        """The other motion's pose (J, 3), where the character would be."""
        shift = (own.root_translation_m[frame] - motion.root_translation_m[frame]) * np.array([1, 0, 1], np.float32)
        return np.asarray(motion.frame(frame).joint_positions_m() + shift, np.float32)

    def turned(angle_rad: float) -> list[list[float]]:
        return [[math.cos(angle_rad / 2), 0.0, math.sin(angle_rad / 2), 0.0]]

    return {
        "waypoint, 0.5 m aside": lambda own: Waypoint(frame, *near(own, 0.5)),
        "waypoint with heading, 0.5 m and 45 degrees": lambda own: Waypoint(frame, *near(own, 0.5), math.pi / 4),
        "heading alone, 45 degrees": lambda own: HeadingTarget(frame, math.pi / 4),
        "heading alone, 90 degrees": lambda own: HeadingTarget(frame, math.pi / 2),
        "head turned alone, 30 degrees": lambda own: JointRotations(frame, [head], turned(math.pi / 6)),
        "keyframe": lambda own: Keyframe(frame, moved(own)),
        "root and right hand": lambda own: JointTargets(frame, [0, hand], moved(own)[[0, hand]]),
    }


async def measure(address: str, steps: int | None, frame: int, samples: int) -> list[str]:
    """The rows of a table, by target."""
    rows = ["| target | position m, mean (worst) | angle rad, mean (worst) | met |", "|---|---|---|---|"]
    found: dict[str, list[Residual]] = {}
    async with MotionClient(address) as client:

        async def clips(prompt: str, seed: int, samples: int, constraints: Sequence[Constraint] = ()) -> list[Clip]:
            options = SessionOptions(seed=seed, denoise_steps=steps)
            return await client.generate_clip(
                prompt, num_frames=FRAMES, num_samples=samples, options=options, constraints=constraints
            )

        for prompt in PROMPTS:
            plain = await clips(prompt, 1, samples)
            other = (await clips(prompt, 100, 1))[0].motion
            for name, target in targets(other, frame).items():
                for sample, clip in enumerate(plain):
                    answer = await clips(prompt, 1 + sample, 1, [target(clip.motion)])
                    found.setdefault(name, []).append(answer[0].residuals[0])
    for name, residuals in found.items():
        rows.append(residual_row(name, residuals))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--server", required=True, help="HOST:PORT of a server")
    parser.add_argument("--denoise-steps", type=int, help="of each window; the model's own number without it")
    parser.add_argument("--frame", type=int, default=36, help="where the targets are, below 60; 40 begins a window")
    parser.add_argument("--samples", type=int, default=4, help="clips of each prompt")
    options = parser.parse_args()
    print("\n".join(asyncio.run(measure(options.server, options.denoise_steps, options.frame, options.samples))))


if __name__ == "__main__":
    main()
