"""`python -m tests.bench.full_size`: models of the released sizes with random weights, from checkpoint to client.

For each model and precision: write a checkpoint folder in the released layout, load it, generate windows with history
and a constraint, and with `--serve` start a server with it and play it with a client. All numbers must be finite.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, save_checkpoint
from motiongen_ardy.checkpoint.released import NICKNAMES, RELEASED
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import ModelConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from tests.bench.machine import machine_facts

SEED = 7
NUM_STEPS = 4
SERVED_S = 4.0
RESULT = TypeVar("RESULT")


@dataclass
class Row:
    """One model in one precision. Times in seconds, sizes in MiB; served_fps: frames per second of a client."""

    model: str
    precision: str
    denoiser_parameters: int
    tokenizer_parameters: int
    folder_mib: float
    write_s: float
    load_s: float
    weights_mib: float
    window_s: float
    ready_s: float | None = None
    served_fps: float | None = None


def random_model(config: ModelConfig) -> Model:
    width = load_skeleton(config.skeleton).feature_dim + LOCAL_ROOT_WIDTH
    torch.manual_seed(SEED)
    return build_model(config, Stats(torch.zeros(width), torch.ones(width))).eval()


def timed(work: Callable[[], RESULT]) -> tuple[RESULT, float]:
    begun = time.perf_counter()
    result = work()
    return result, time.perf_counter() - begun


def seconds_a_window(model: Model) -> float:
    """Generate two windows, the second with history, towards a waypoint beyond them. Raises unless all are finite."""
    config = model.config
    targets = Targets(model.skeleton)
    targets.add_waypoints([2 * config.horizon + 7], torch.tensor([[0.5, 1.0]]))
    text = torch.randn(config.denoiser.text_dim, generator=torch.Generator().manual_seed(SEED))
    request = RolloutRequest(2 * config.horizon, text, seed=SEED, num_steps=NUM_STEPS, targets=targets)
    features, seconds = timed(lambda: rollout(model, request))
    if features.shape != (2 * config.horizon, model.representation.feature_dim) or not bool(features.isfinite().all()):
        raise RuntimeError(f"generated {tuple(features.shape)} features, finite: {bool(features.isfinite().all())}")
    return seconds / 2


def serve(folder: Path, precision: str) -> tuple[float, float]:
    """Seconds until a server is ready, and frames per second that one client gets from it, as fast as it can."""
    from motiongen_client.blocking import MotionClient
    from motiongen_tools.server_process import ServerProcess

    settings = ["--model", str(folder), "--text-encoder", "hashed", "--precision", precision]
    settings += ["--denoise-steps", str(NUM_STEPS), "--playback-rate", "1000"]
    with ServerProcess(settings) as server, MotionClient(server.address) as client:
        session = client.open(prompt="a person walks forward")
        session.add_waypoint(0.5, 1.0, frame=60)
        begun = time.perf_counter()
        frames = [np.asarray(frame.root_translation_m) for frame in session.frames(SERVED_S, realtime=False)]
        seconds = time.perf_counter() - begun
        if not np.isfinite(frames).all():
            raise RuntimeError("the server sent numbers that are not finite")
        return server.ready_s, len(frames) / seconds


def write_random(name: str, folder: Path) -> tuple[int, int, float]:
    """Write a model's folder with random weights. Returns parameters of denoiser and tokenizer, and the seconds."""
    model = random_model(RELEASED[NICKNAMES[name]])
    assert model.tokenizer is not None
    denoiser, tokenizer = (
        sum(part.numel() for part in module.parameters()) for module in (model.denoiser, model.tokenizer)
    )
    _, write_s = timed(lambda: save_checkpoint(model, folder))
    return denoiser, tokenizer, write_s


def load_and_generate(folder: Path, precision: str) -> tuple[float, float, float]:
    """Seconds to load, MiB of weights, seconds per window."""
    model, load_s = timed(lambda: load_checkpoint(folder, dtype=PRECISIONS[precision]))
    held = sum(part.numel() * part.element_size() for part in model.parameters())
    return load_s, held / 2**20, seconds_a_window(model)


def measure(name: str, precision: str, folder: Path, served: bool) -> Row:
    denoiser, tokenizer, write_s = write_random(name, folder)
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    row = Row(name, precision, denoiser, tokenizer, size / 2**20, write_s, *load_and_generate(folder, precision))
    if served:
        row.ready_s, row.served_fps = serve(folder, precision)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.full_size", description=__doc__)
    parser.add_argument("--models", nargs="+", default=["core", "g1"], choices=list(NICKNAMES))
    parser.add_argument("--precisions", nargs="+", default=list(PRECISIONS), choices=list(PRECISIONS))
    parser.add_argument("--serve", action="store_true", help="also start a server with each model and play it")
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    arguments = parser.parse_args()
    facts = machine_facts() | {"threads": str(torch.get_num_threads())}
    print("\n".join(f"{key}: {value}" for key, value in facts.items()))
    print(f"\n{'model':<7}{'precision':<10}{'denoiser':>13}{'tokenizer':>12}{'folder':>9}{'write':>8}{'load':>7}"
          f"{'weights':>10}{'window':>9}{'ready':>8}{'served':>10}")  # fmt: skip
    rows = []
    for name in arguments.models:
        for precision in arguments.precisions:
            with tempfile.TemporaryDirectory() as folder:
                row = measure(name, precision, Path(folder), arguments.serve)
            rows.append(row)
            ready, fps = ("-" if row.ready_s is None else f"{row.ready_s:.1f} s",
                          "-" if row.served_fps is None else f"{row.served_fps:.1f} fps")  # fmt: skip
            print(f"{name:<7}{precision:<10}{row.denoiser_parameters:>13,}{row.tokenizer_parameters:>12,}"
                  f"{row.folder_mib:>5.0f} MiB{row.write_s:>6.1f} s{row.load_s:>5.1f} s{row.weights_mib:>6.0f} MiB"
                  f"{row.window_s:>7.2f} s{ready:>8}{fps:>10}", flush=True)  # fmt: skip
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nwindow: seconds for one window of one character, {NUM_STEPS} steps, text and constraint guidance; "
          f"most memory of this process {peak:.0f} MiB")  # fmt: skip
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": facts, "rows": [asdict(row) for row in rows]}, indent=2))


if __name__ == "__main__":
    sys.exit(main())
