"""Make the prompt domain of a model: `python -m motiongen_ardy.train.prompt_domain DATA OUT`.

Reads the captions of a training set, keeps those that represent the rest, and sets the threshold between two lists of
prompts that are not captions: those that the model should know, and those that it should not. Labels with few clips do
not count: three jumps in four hours do not teach a model to jump. Nor do labels that the trained model was seen not to
show (`--without`), however often the captures show them.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path

from motiongen_ardy.capabilities import CAPABILITIES_FILE, read_capabilities
from motiongen_ardy.checkpoint.checkpoint import CONFIG_FILE
from motiongen_ardy.checkpoint.config import read_model_config
from motiongen_ardy.checkpoint.files import CheckpointError, path_inside, read_yaml
from motiongen_ardy.core.output import command
from motiongen_ardy.core.problems import Problems
from motiongen_ardy.data.dataset import Clip, DatasetError, MotionDataset
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.text.domain import DOMAIN_FILE, DomainError, best_threshold, make_domain, write_domain
from motiongen_ardy.text.encoder import TextWidthMismatch, UnknownTextEncoder

MIN_CLIPS = 8
MOST_KEPT = 700  # at 256 numbers per caption, 180 kB
CONFIGS = Path(str(resources.files("motiongen_ardy"))) / "train" / "configs"


def known_captions(clips: Iterable[Clip], min_clips: int = MIN_CLIPS, without: Collection[str] = ()) -> list[str]:
    """The captions, sorted and unique, of contents that at least min_clips captured clips or segments show; contents in
    `without` are left out.

    Derived clips combine two or three actions in one caption, thousands of times; prompts with a single action would be
    far from those.
    """
    counts: Counter[str] = Counter()
    captions: defaultdict[str, set[str]] = defaultdict(set)
    for clip in clips:
        if clip.derived_from:
            continue
        for part in (clip, *clip.segments):
            counts[part.content] += 1
            captions[part.content] |= set(part.captions)
    kept = (texts for content, texts in captions.items() if counts[content] >= min_clips and content not in without)
    return sorted({text for texts in kept for text in texts})


def read_prompts(path: Path) -> list[str]:
    """The lines of a list of prompts. Raises DomainError if it cannot be read or is empty."""
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8-sig").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise DomainError(f"{path} cannot be read: {error}") from error
    prompts = [line for line in lines if line]
    if not prompts:
        raise DomainError(f"{path} holds no prompt; give one a line")
    return prompts


def text_width(folder: Path) -> int | None:
    """The width of the text vectors of a checkpoint folder's model; None for a folder without a model.

    Raises CheckpointError or ConfigError.
    """
    path = path_inside(folder, CONFIG_FILE)
    return read_model_config(read_yaml(path))[0].denoiser.text_dim if path.exists() else None


def main(arguments: list[str] | None = None) -> int:
    """Command line. Returns 2 for input that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.prompt_domain", description=__doc__)
    parser.add_argument("data", type=Path, help="training set, as python -m motiongen_ardy.data build wrote it")
    parser.add_argument("out", type=Path, help=f"checkpoint folder to write {DOMAIN_FILE} to")
    parser.add_argument("--text-encoder", default="static", help="the model's text encoder (default: %(default)s)")
    parser.add_argument("--inside", type=Path, default=CONFIGS / "prompts-inside.txt", help="prompts it should know")
    parser.add_argument("--outside", type=Path, default=CONFIGS / "prompts-outside.txt", help="those it should not")
    parser.add_argument("--min-clips", type=int, default=MIN_CLIPS, help="clips that a label needs to count")
    parser.add_argument("--without", nargs="*", default=(), metavar="LABEL", help="labels that the model fails to show")
    parser.add_argument("--most", type=int, default=MOST_KEPT, help="captions to keep (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        if not read_capabilities(options.out).knows:  # with a domain alone, nothing could read the folder
            raise CheckpointError(
                f"{options.out} says nothing under knows in a {CAPABILITIES_FILE}, which a prompt domain needs"
            )
        clips = MotionDataset.load(options.data, "train").clips
        labels = {part.content for clip in clips for part in (clip, *clip.segments)}
        if unknown := sorted(set(options.without) - labels):
            known = ", ".join(sorted(labels))
            raise DomainError(f"--without {' '.join(unknown)}: the training set has no such label; it has {known}")
        captions = known_captions(clips, options.min_clips, options.without)
        inside, outside = read_prompts(options.inside), read_prompts(options.outside)
        encoder = load_text_encoder(options.text_encoder, text_width(options.out))
        domain = make_domain(encoder.identity, encoder.encode(captions), options.most)
        near, far = (domain.distances(encoder.encode(texts)) for texts in (inside, outside))
        threshold, alarms, misses = best_threshold(near, far)
        write_domain(options.out / DOMAIN_FILE, replace(domain, threshold=threshold))
    except (Problems, DatasetError, DomainError, UnknownTextEncoder, TextWidthMismatch, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{len(domain.directions)} of {len(captions)} captions kept; threshold {threshold:.3f}")
    print(f"judged outside: {alarms} of {len(inside)} inside; judged inside: {misses} of {len(outside)} outside")
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
