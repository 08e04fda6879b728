"""Golden vectors of the ground: a body of nine joints walks over slopes, stairs and hills, whole and as played."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from motiongen_client.ground import Ground, GroundFollower, Heights
from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Frame, Motion, Rig
from motiongen_client.playback import Playback
from motiongen_client.sampling import Sampler
from tests.client.bodies import FPS, walking
from tests.client.golden.draws import numbers

_LEG = ("UpLeg", "Leg", "Foot", "ToeBase")
_OFFSETS = [[0.1, -0.05, 0.0], [0.0, -0.42, 0.01], [0.0, -0.42, -0.02], [0.0, -0.0585, 0.14]]
RIG = Rig(
    "walker",
    ("Hips", *("Left" + name for name in _LEG), *("Right" + name for name in _LEG)),
    (-1, 0, 1, 2, 3, 0, 5, 6, 7),
    np.array([[0.0, 0.0, 0.0], *_OFFSETS, *([-x, y, z] for x, y, z in _OFFSETS)], np.float32),
    FPS,
    {ROOT_BLOCK: 3, ROTATION_BLOCK: 36, CONTACT_BLOCK: 4},
    limbs={"LeftFoot": (3, 4), "RightFoot": (7, 8)},
)
FRAMES = 64
GROUNDS: dict[str, Heights] = {
    "level": lambda x, z: np.zeros_like(x),
    "slope": lambda x, z: 0.2 * z + 0.1 * x,
    "stairs": lambda x, z: -0.12 * np.floor((z + 0.26) / 0.6),
    "hills": lambda x, z: 0.08 * np.sin(1.7 * z) + 0.05 * np.cos(2.1 * x),
}


def walk() -> Motion:
    """The walk, rounded as in the file."""
    rows = walking(RIG, FRAMES, speed_mps=1.0).rows
    return Motion(RIG, 0, np.array([[float(f"{value:.6g}") for value in row] for row in rows], np.float32))


def ground() -> Iterator[str]:
    for joint, name in enumerate(RIG.joint_names):
        yield f"joint {name} {RIG.parents[joint]} {numbers(RIG.offsets_m[joint])}"
    motion = walk()
    for row in motion.rows:
        yield f"row {numbers(row)}"
    for name, heights in GROUNDS.items():
        made = Ground(RIG, heights).apply(motion)
        yield f"apply {name} -> {numbers(made.rows[::7])}"
        if name != "level":
            yield from followed(name, motion)


def followed(name: str, motion: Motion) -> Iterator[str]:
    """A replan that turns aside while a foot is in the air, and a cut to elsewhere."""
    playback = Playback(FPS, RIG.row_width)
    sampler, follower = Sampler(RIG, playback), GroundFollower(Ground(RIG, GROUNDS[name]), playback)
    yield f"begin {name} {FPS}"
    # plan, first frame, number of frames, from which frame of the walk, sideways shift per frame, whether it is a cut
    chunks = iter([(1, 0, 30, 0, 0.0, 0), (2, 22, 24, 22, 0.02, 0), (3, 40, 20, 8, -0.05, 1)])
    for tick in range(int(55 / FPS * 60)):
        if tick in (0, 60, 111):
            plan, first, count, source, aside_m, is_cut = next(chunks)
            rows = motion.rows[source : source + count].copy()
            rows[:, 0] += np.float32(aside_m) * np.arange(1, count + 1, dtype=np.float32)
            playback.announce_plan(plan, first, is_cut=is_cut == 1)
            playback.add_chunk(plan, first, rows, 0)
            yield f"chunk {plan} {first} {count} {source} {aside_m} {is_cut}"
        now_s = tick / 60 + 0.003
        playback.advance(now_s)
        share, row = sampler.row(now_s)
        shown = follower.frame(Frame(RIG, playback.playhead, row, share=share))
        legs = [shown.row[1], *shown.joint_rotation_quat_wxyz[[1, 2, 3, 5, 6, 7]].ravel()]
        answer = f"{playback.playhead} {numbers(legs)}" if tick % 3 == 0 else f"{playback.playhead} {numbers(legs[:1])}"
        yield f"sample {now_s:.9f} -> {answer}"
    assert math.isclose(playback.playhead, 54, abs_tol=1), "it has been played to its end"
