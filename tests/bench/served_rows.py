"""Rows of the evaluation, measured through gRPC: `python -m tests.bench.served_rows [--seeds N] [--address HOST:PORT]`.

Plays characters of the built-in model on a real server with the Python client, measures them as the evaluation does,
and compares each figure with that of the library's own windows. Clips of the service are the same windows from the same
noise, so their figures agree; a session that is steered is replanned at the frame where its edit takes effect.
"""

from __future__ import annotations

import argparse
import asyncio
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.capabilities import read_capabilities
from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.evaluate.measures.feet import slowest_foot
from motiongen_ardy.evaluate.rows.velocity import STAND, WALK
from motiongen_ardy.evaluate.sampler import Sampler, Sampling
from motiongen_ardy.evaluate.take import Steer, Take
from motiongen_ardy.text import load_text_encoder
from motiongen_client import MotionClient, SessionOptions, Waypoint
from motiongen_tools.server_process import ServerProcess

MODEL, STEPS, FPS = "motiongen-mini", 4, 20
SPEED_M_S, STEERED_S = 1.2, 4.0
LEAD = 3 * FPS


@dataclass(frozen=True)
class Row:
    """One figure, measured through the server and with the library."""

    name: str
    served: float
    library: float


@dataclass(frozen=True)
class Script:
    """A clip's script, and what is measured in its positions (T, J, 3). goal: frame, x and z in metres."""

    name: str
    num_frames: int
    prompts: tuple[tuple[int, str], ...]
    measure: Callable[[Skeleton, Tensor], float]
    goal: tuple[int, float, float] | None = None


def _miss(skeleton: Skeleton, positions: Tensor, goal: tuple[int, float, float]) -> float:
    frame, x, z = goal
    return math.hypot(float(positions[frame, 0, 0]) - x, float(positions[frame, 0, 2]) - z)


def _feet(skeleton: Skeleton, positions: Tensor, first: int = 0) -> float:
    return slowest_foot(skeleton, positions[first:], FPS)


def scripts() -> list[Script]:
    """Waypoints, feet, and a start, each from standing at the origin."""
    goal = (3 * FPS, 0.4, 2.4)
    near = (2 * FPS, 0.0, 1.2)
    return [
        Script("waypoint, 3 s: miss", 70, ((0, WALK),), lambda one, at: _miss(one, at, goal), goal),
        Script("waypoint under stands, 2 s: miss", 60, ((0, STAND),), lambda one, at: _miss(one, at, near), near),
        Script("waypoint under stands, 2 s: slowest foot", 41, ((0, STAND),), _feet, near),
        Script("steady walk: slowest foot", 120, ((0, WALK),), lambda one, at: _feet(one, at, 2 * FPS)),
        Script(
            "stand to walk: slowest foot", 2 * LEAD, ((0, STAND), (LEAD, WALK)), lambda one, at: _feet(one, at, LEAD)
        ),
    ]


def library_sampler() -> Sampler:
    """The built-in model as the evaluation samples it."""
    folder = model_folder(MODEL)
    model = load_checkpoint(folder)
    encoder = load_text_encoder("static", model.config.denoiser.text_dim)
    return Sampler(model, encoder, Sampling(STEPS), read_capabilities(folder).locomotion)


async def served_rows(address: str, seeds: Sequence[int], sampler: Sampler) -> list[Row]:
    """All rows, as means over the seeds."""
    skeleton = sampler.model.skeleton
    rows = []
    async with MotionClient(address) as client:
        for script in scripts():
            takes = [_take(script, seed, skeleton) for seed in seeds]
            library = [script.measure(skeleton, result.positions) for result in sampler.run(takes)]
            served = [script.measure(skeleton, await _clip(client, script, seed)) for seed in seeds]
            rows.append(Row(script.name, float(np.mean(served)), float(np.mean(library))))
        shares = [await _steered(client, seed, sampler) for seed in seeds]
    name = f"{SPEED_M_S:g} m/s under stands: share of it reached after 1 s"
    rows.append(Row(name, *(float(np.mean(values)) for values in zip(*shares, strict=True))))
    return rows


def _take(script: Script, seed: int, skeleton: Skeleton) -> Take:
    targets = None
    if script.goal is not None:
        frame, x, z = script.goal
        targets = Targets(skeleton)
        targets.add_waypoints([frame], torch.tensor([[x, z]]))
    return Take(script.name, seed, script.num_frames, script.prompts, targets=targets)


async def _clip(client: MotionClient, script: Script, seed: int) -> Tensor:
    """Positions (T, J, 3) of the script's clip."""
    (made,) = await client.generate_clip(
        script.prompts[0][1],
        num_frames=script.num_frames,
        later_prompts=dict(script.prompts[1:]),
        options=SessionOptions(seed=seed, denoise_steps=STEPS),
        constraints=[] if script.goal is None else [Waypoint(*script.goal)],
    )
    return torch.from_numpy(np.array(made.motion.joint_positions_m()))


async def _steered(client: MotionClient, seed: int, sampler: Sampler) -> tuple[float, float]:
    """The share of its speed that a session reaches, and that of the library's take, edited from the same frame on."""
    session = await client.open(STAND, options=SessionOptions(seed=seed, denoise_steps=STEPS))
    _ = [frame async for frame in session.frames(seconds=1, realtime=False)]
    edit = session.set_velocity(0.0, SPEED_M_S, seconds=2 * STEERED_S)
    _ = [frame async for frame in session.frames(seconds=STEERED_S, realtime=False)]
    effective = (await edit).effective_frame
    assert effective is not None
    positions = torch.from_numpy(np.array(session.motion().joint_positions_m()))
    await session.close()
    num_frames = len(positions)
    take = Take("steered", seed, num_frames, ((0, STAND),), steers=(Steer(effective, 0.0, SPEED_M_S),))
    (result,) = sampler.run([take])
    first = effective + FPS
    served, library = (
        float(at[first + FPS, 0, 2] - at[first, 0, 2]) / SPEED_M_S for at in (positions, result.positions)
    )
    return served, library


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.served_rows", description=__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="takes of each row (default %(default)s)")
    parser.add_argument("--address", help="a server with the built-in model (default: one is started)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    with ExitStack() as stack:
        address = options.address or stack.enter_context(ServerProcess(["--devices", "cpu:1"])).address
        rows = asyncio.run(served_rows(address, range(options.seeds), library_sampler()))
    print(f"{'row':52} {'served':>9} {'library':>9}")
    for row in rows:
        print(f"{row.name:52} {row.served:9.4f} {row.library:9.4f}")


if __name__ == "__main__":
    main()
