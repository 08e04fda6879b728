"""Measure the usual speeds of prompts: `python -m motiongen_ardy.train.prompt_paces DATA FOLDER`.

Measures how fast the captures of each caption move, keeps the captions that represent the rest, and writes them beside
the weights, with the gaits of the folder's capabilities. They decide which text a window is given if its path
contradicts its prompt (`motiongen_ardy.model.sampling.paces`).
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from motiongen_ardy.capabilities import DIRECTIONS, read_capabilities
from motiongen_ardy.checkpoint.files import CheckpointError
from motiongen_ardy.checkpoint.paces_file import PACES_FILE, write_paces
from motiongen_ardy.checkpoint.sampling_file import SAMPLING_FILE
from motiongen_ardy.core.output import command
from motiongen_ardy.core.problems import Problems
from motiongen_ardy.data.dataset import Clip, DatasetError, MotionDataset
from motiongen_ardy.model.sampling.paces import SPEED_FRAMES, PromptPaces
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.text.domain import DomainError, best_threshold, spread_out
from motiongen_ardy.text.encoder import TextWidthMismatch, UnknownTextEncoder
from motiongen_ardy.train.prompt_domain import CONFIGS, MIN_CLIPS, known_captions, read_prompts, text_width

MOST_KEPT = 400  # at 256 numbers of two bytes per caption, 200 kB
MIN_FRAMES = 20
USUAL = (0.05, 0.95)
APART_M_S = 0.3
PROMPTS = ("prompts-inside.txt", "prompts-outside.txt")


def caption_speeds(clips: Iterable[Clip], fps: float) -> dict[str, tuple[float, float]]:
    """The 5th and 95th percentile of the root's ground speed, in m/s, in the captures of each caption.

    A clip's own captions count where no segment has narrower ones; captions with less than a second do not count.
    """
    speeds: defaultdict[str, list[np.ndarray]] = defaultdict(list)
    for clip in clips:
        ground = clip.root_positions[:, [0, 2]].numpy()
        if clip.derived_from or len(ground) <= SPEED_FRAMES:
            continue
        speed = np.hypot(*(ground[SPEED_FRAMES:] - ground[:-SPEED_FRAMES]).T) * fps / SPEED_FRAMES
        own = np.ones(len(ground), bool)
        for part in clip.segments:
            own[part.start : part.start + part.length] = False
            for caption in part.captions:
                speeds[caption].append(speed[part.start : max(part.start, part.start + part.length - SPEED_FRAMES)])
        for caption in clip.captions:
            speeds[caption].append(speed[own[SPEED_FRAMES:] & own[:-SPEED_FRAMES]])
    found = {caption: np.concatenate(parts) for caption, parts in speeds.items()}
    return {
        caption: (float(np.quantile(all_of_it, USUAL[0])), float(np.quantile(all_of_it, USUAL[1])))
        for caption, all_of_it in found.items()
        if len(all_of_it) >= MIN_FRAMES
    }


def main(arguments: list[str] | None = None) -> int:
    """Command line. Returns 2 for input that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.prompt_paces", description=__doc__)
    parser.add_argument("data", type=Path, help="training set, as python -m motiongen_ardy.data build wrote it")
    parser.add_argument("folder", type=Path, help=f"checkpoint folder to write {PACES_FILE} to, with its capabilities")
    parser.add_argument("--text-encoder", default="static", help="the model's text encoder (default: %(default)s)")
    parser.add_argument("--most", type=int, default=MOST_KEPT, help="captions to keep (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        gaits = read_capabilities(options.folder).locomotion
        if not gaits:
            raise CheckpointError(f"{options.folder} names no gaits; list them under locomotion in capabilities.yaml")
        dataset = MotionDataset.load(options.data, "train")
        measured = caption_speeds(dataset.clips, dataset.fps)
        captions = [text for text in known_captions(dataset.clips, MIN_CLIPS) if text in measured]
        if not captions:
            raise DomainError(
                f"no label is shown by {MIN_CLIPS} captured clips or parts of clips, so no paces are known: "
                f"set fit_prompts to false in {options.folder / SAMPLING_FILE}, if it is true there"
            )
        encoder = load_text_encoder(options.text_encoder, text_width(options.folder))
        vectors = encoder.encode(captions)
        mean, directions, kept = spread_out(vectors, options.most)
        speeds = np.array([measured[text] for text in captions], np.float32)
        nearest = (directions @ directions[kept].T).argmax(axis=1)
        paces = PromptPaces(
            mean=torch.from_numpy(mean),
            directions=torch.from_numpy(directions[kept]),
            speeds=torch.from_numpy(_of_groups(speeds, nearest, len(kept))),
            threshold=2.0,
            gaits=torch.from_numpy(encoder.encode([gait.text for gait in gaits])),
            from_mps=torch.tensor([gait.from_mps for gait in gaits]),
            quarters=torch.tensor([float(DIRECTIONS.index(gait.direction)) for gait in gaits]),
        )
        near, far = (_distances(paces, encoder.encode(read_prompts(CONFIGS / name))) for name in PROMPTS)
        threshold, alarms, misses = best_threshold(near, far)
        paces = replace(paces, threshold=threshold)
        write_paces(options.folder / PACES_FILE, paces)
    except (Problems, DatasetError, DomainError, UnknownTextEncoder, TextWidthMismatch, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    slow, fast = paces.speeds.numpy()[nearest].T
    apart = (slow > speeds[:, 1] + APART_M_S) | (fast < speeds[:, 0] - APART_M_S)
    print(f"{len(kept)} of {len(captions)} captions kept; threshold {threshold:.3f}")
    print(
        f"judged unlike all captions: {alarms} of {len(near)} inside; judged like one: {misses} of {len(far)} outside"
    )
    print(f"captions whose nearest kept one goes at another pace: {int(apart.sum())}")
    return 0


def _of_groups(speeds: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """The speeds (count, 2) of representative captions: those of their groups without the slowest and fastest tenth."""
    least, most = 2 * USUAL[0], 1 - 2 * USUAL[0]
    members = [speeds[group == number] for number in range(count)]
    return np.array([(np.quantile(one[:, 0], least), np.quantile(one[:, 1], most)) for one in members], np.float32)


def _distances(paces: PromptPaces, vectors: np.ndarray) -> np.ndarray:
    """(M): one minus the cosine of each prompt (M, W) to the nearest caption."""
    offsets = torch.nn.functional.normalize(torch.from_numpy(vectors), dim=1) - paces.mean
    cosines = torch.nn.functional.normalize(offsets, dim=1) @ paces.directions.T
    distances: np.ndarray = (1 - cosines.amax(dim=1)).numpy()
    return distances


if __name__ == "__main__":
    sys.exit(command(main))
