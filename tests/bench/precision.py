"""What bfloat16 and kept history tokens gain and cost: `python -m tests.bench.precision`.

The same characters (prompts, seeds, waypoints) are generated in each way; figures of quality are over all of them.
The spread of float32 over other seeds tells which differences mean anything.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import model_folder
from motiongen_ardy.evaluate.measures.feet import skate_in_contact
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_server.engine.types import Float32Array
from motiongen_server.runner import TorchRunner
from tests.bench.machine import machine_facts
from tests.bench.models import bench_model
from tests.bench.windows import Walk, generate

NUM_WINDOWS = 4
WAYPOINT_FRAME = 110
DISTANCE_M = 6.5


def make_walks(embeddings: list[Float32Array], count: int, first_seed: int) -> list[Walk]:
    """Every other character walks to a waypoint 5.5 s ahead, which a walk that turns a little can reach."""
    random = np.random.default_rng(0)
    walks = []
    for index in range(count):
        angle = random.uniform(-0.3, 0.3)
        goal = ((WAYPOINT_FRAME, DISTANCE_M * float(np.sin(angle)), DISTANCE_M * float(np.cos(angle))),)
        embedding = embeddings[0] if index % 2 else embeddings[index // 2 % len(embeddings)]
        walks.append(Walk(first_seed + index, embedding, goal if index % 2 else ()))
    return walks


def seam_ratio(motion: Tensor, positions: Tensor, horizon: int) -> float:
    """Acceleration of joints across window borders relative to that elsewhere; 1 is seamless."""
    acceleration = positions.diff(dim=1).diff(dim=1).norm(dim=-1).mean(dim=-1)  # (B, T - 2), of frame i + 1
    middle = torch.arange(1, motion.shape[1] - 1)
    border = (middle % horizon == 0) | (middle % horizon == horizon - 1)
    return float(acceleration[:, border].mean() / acceleration[:, ~border].mean())


def figures(model: Model, walks: list[Walk], features: Float32Array) -> dict[str, float]:
    """Figures of quality of normalised features (B, T, D)."""
    layout = model.representation
    motion = layout.denormalize(torch.from_numpy(features))
    positions = layout.positions(motion)
    jerk = positions.diff(dim=1).diff(dim=1).diff(dim=1).norm(dim=-1).mean() * layout.fps**3
    misses = [
        float((motion[index, frame, [0, 2]] - torch.tensor([x, z])).norm())
        for index, walk in enumerate(walks)
        for frame, x, z in walk.waypoints
    ]
    contacts = motion[..., layout.contact_block] > 0.5
    sliding = [skate_in_contact(layout.skeleton, *pair, layout.fps) for pair in zip(positions, contacts, strict=True)]
    return {
        "sliding m/s": float(np.nanmean(sliding)),
        "waypoint error m": float(np.mean(misses)),
        "jerk m/s3": float(jerk),
        "seam ratio": seam_ratio(motion, positions, model.config.horizon),
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.precision", description=__doc__)
    parser.add_argument("--model", default="motiongen-mini", help="built-in model or checkpoint folder")
    parser.add_argument("--characters", type=int, default=64)
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    arguments = parser.parse_args()
    model = load_checkpoint(model_folder(arguments.model), arguments.device)
    embeddings = list(bench_model(arguments.model).embeddings)
    ways = [
        ("float32, tokens kept", "float32", True, 0),
        ("float32, tokens kept, other seeds", "float32", True, 10_000),
        ("float32, encoded again", "float32", False, 0),
        ("bfloat16, tokens kept", "bfloat16", True, 0),
        ("bfloat16, encoded again", "bfloat16", False, 0),
    ]
    facts, rows = machine_facts(), {}
    with torch.inference_mode():
        for name, precision, reuse_tokens, first_seed in ways:
            runner = TorchRunner(model, "bench", precision=PRECISIONS[precision])
            walks = make_walks(embeddings, arguments.characters, first_seed)
            generate(runner, walks[:2], 2, 2)
            begun = time.perf_counter()
            features = generate(runner, walks, NUM_WINDOWS, arguments.steps, reuse_tokens)
            rate = arguments.characters * NUM_WINDOWS / (time.perf_counter() - begun)
            rows[name] = figures(model, walks, features) | {"windows/s": rate}
    table = Table("way", *next(iter(rows.values())), title=f"{arguments.model}, {arguments.steps} steps")
    for name, values in rows.items():
        table.add_row(name, *(f"{value:.3g}" for value in values.values()))
    console = Console()
    for name, fact in facts.items():
        console.print(f"{name}: {fact}", highlight=False)
    console.print(table)
    arguments.out.mkdir(parents=True, exist_ok=True)
    target = arguments.out / "precision.json"
    target.write_text(json.dumps({"machine": facts, "ways": rows}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
