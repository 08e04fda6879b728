"""Encode prompts into a file for servers: python -m motiongen_ardy.text IN.txt OUT.safetensors --encoder llm2vec

A line of IN.txt is an id, a tab and a prompt; or only a prompt, which is then its own id (if it is longer than 64
characters, its beginning and a hash). All lines, and the output path, are checked before anything is encoded.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from motiongen_ardy.core.output import command
from motiongen_ardy.text.loading import FORMS, load_text_encoder
from motiongen_ardy.text.prompt_file import (
    PromptFileError,
    check_place,
    check_prompts,
    encode_prompts,
    id_of,
    write_prompt_file,
)


def read_lines(path: Path) -> list[tuple[str, str]]:
    """The pairs (id, prompt) in a file; blank lines are skipped. Raises PromptFileError if there are none."""
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors begin a file with a byte order mark
    except UnicodeDecodeError as error:
        raise PromptFileError(f"{path} is not UTF-8, from byte {error.start} on; save it as UTF-8") from None
    pairs = []
    for line in text.split("\n"):  # reading has normalised line ends; prompts may contain other separators
        name, separator, prompt = line.partition("\t")
        if line.strip():
            prompt = (prompt if separator else name).strip()
            pairs.append((name.strip() if separator else id_of(prompt), prompt))
    if not pairs:
        raise PromptFileError(f"{path} has no prompt; give one a line")
    return pairs


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m motiongen_ardy.text", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("prompts", type=Path, help="text file, one prompt per line")
    parser.add_argument("out", type=Path, help="file to write")
    parser.add_argument("--encoder", default="static", help=f"{FORMS} (default %(default)s)")
    parser.add_argument("--width", type=int, help="numbers in a vector; required for hashed, which fits any model")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"), help="for llm2vec (default %(default)s)")
    parser.add_argument(
        "--precision", default="bfloat16", choices=("float32", "bfloat16"), help="for llm2vec (default %(default)s)"
    )
    given = parser.parse_args(arguments)
    try:
        lines = read_lines(given.prompts)
        check_prompts([name for name, _ in lines], [text for _, text in lines])
        check_place(given.out)
        encoder = load_text_encoder(given.encoder, given.width, given.device, given.precision)
        prompts = encode_prompts(encoder, lines)
        write_prompt_file(given.out, prompts)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{given.out}: {len(prompts.ids)} prompts, {encoder.width} numbers each, from {encoder.identity}")
    return 0


if __name__ == "__main__":
    sys.exit(command(main))
