"""Windows per second of `motiongen_ardy.model.rollout`, one character after another.

`python -m tests.bench.rollout_baseline --steps 4`.

It runs in its own process, so that the benchmark, which is also the client, does not load torch. Prints a JSON line.
"""

from __future__ import annotations

import argparse
import json
import time

import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.model_card import BUILT_IN_MODEL, model_folder
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.text import load_text_encoder

NUM_WINDOWS = 4  # of each character: the first without history, the others with it


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.rollout_baseline", description=__doc__)
    parser.add_argument("--steps", type=int, required=True, help="denoising steps of a window")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to measure")
    parser.add_argument("--guidance", type=float, default=2.0, help="weight of text and of constraints")
    options = parser.parse_args()
    model = load_checkpoint(model_folder(BUILT_IN_MODEL), "cpu")
    encoder = load_text_encoder("static", model.config.denoiser.text_dim)
    text = torch.from_numpy(encoder.encode(["a person walks forward"])[0])

    def character(seed: int) -> None:
        weights = GuidanceWeights(options.guidance, options.guidance)
        num_frames = NUM_WINDOWS * model.config.horizon
        rollout(model, RolloutRequest(num_frames, text, seed=seed, num_steps=options.steps, weights=weights))

    character(0)
    num_characters, started_s = 0, time.perf_counter()
    while (elapsed_s := time.perf_counter() - started_s) < options.seconds:
        num_characters += 1
        character(num_characters)
    print(json.dumps({"windows_per_s": num_characters * NUM_WINDOWS / elapsed_s, "threads": torch.get_num_threads()}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
