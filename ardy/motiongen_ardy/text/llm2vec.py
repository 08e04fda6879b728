"""LLM2Vec in this process: the encoder with which NVIDIA's ARDY models were trained.

A Llama with bidirectional attention (BehnamGhader et al. 2024, "LLM2Vec"), two adapters merged into it, and the mean
over the prompt's own tokens. Needs transformers and peft: pip install 'motiongen-ardy[llm2vec]'.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.checkpoint.hub import HubError, fetch_files
from motiongen_ardy.model.precision import PRECISIONS
from motiongen_ardy.text.encoder import EachTextEncoder, UnknownTextEncoder, Vectors

if TYPE_CHECKING:
    from transformers import LlamaModel, PreTrainedTokenizerBase

FIRST_ADAPTER = "McGill-NLP/LLM2Vec-Meta-Llama-3-8B-Instruct-mntp"
"""Adapts the Llama to bidirectional attention. Its configuration names the Llama."""
SECOND_ADAPTER = "McGill-NLP/LLM2Vec-Meta-Llama-3-8B-Instruct-mntp-supervised"
"""Trains it to compare sentences."""
FOLDERS_VARIABLE = "TEXT_ENCODERS_DIR"
BEFORE, AFTER = "<|start_header_id|>user<|end_header_id|>\n\n", "<|eot_id|>"
"""Llama 3's markup around a user's message."""
MAX_TOKENS = 512
MAX_TEXT_TOKENS = 400
SAMPLE_BYTES = 1 << 20
SETTINGS = ("config.json", "adapter_config.json", "tokenizer.json")
MODEL_FILES = ("*.json", "*.safetensors", "tokenizer.model")
MISSING = "the text encoder llm2vec needs transformers and peft: pip install 'motiongen-ardy[llm2vec]'"


@dataclass(frozen=True)
class Llm2VecFolders:
    """The folders of its parts: the Llama with its tokenizer, and the adapters in the order of merging."""

    llama: Path
    adapters: tuple[Path, ...]


class Llm2VecEncoder(EachTextEncoder):
    """Encodes one prompt at a time: in a batch, results depend on the batch's size, above all in bfloat16.

    identity: derived from the content of the folders and the precision.
    """

    def __init__(self, folders: Llm2VecFolders, device: str = "cpu", precision: str = "bfloat16") -> None:
        """Loads the weights: 15 GiB of memory in bfloat16, twice as much in float32. Raises UnknownTextEncoder."""
        if precision not in PRECISIONS:
            raise UnknownTextEncoder(f"precision {precision!r} of llm2vec; it must be {' or '.join(PRECISIONS)}")
        try:
            self._tokenizer, self._model = _load(folders, PRECISIONS[precision])
        except ImportError as error:
            raise UnknownTextEncoder(f"{MISSING} ({error})") from error
        except UnknownTextEncoder:
            raise
        except Exception as error:  # the libraries that read its files share no error class
            raise UnknownTextEncoder(f"cannot load llm2vec from {folders.llama}: {error}") from error
        self._device = device
        self._model.to(device)  # type: ignore[arg-type]
        self._one_at_a_time = threading.Lock()
        super().__init__(f"llm2vec-{fingerprint(folders)}-{precision}", int(self._model.config.hidden_size))

    def encode_one(self, text: str) -> Vectors:
        with self._one_at_a_time, torch.inference_mode():
            return self._encoded(text)

    def _encoded(self, text: str) -> Vectors:
        text = shortened(text, self._num_tokens)
        tokens: list[int] = self._tokenizer(BEFORE + text.rstrip() + AFTER, truncation=True, max_length=MAX_TOKENS)[
            "input_ids"
        ]
        # Tokenized separately, as in training: next to the preceding markup, the tokenizer may split differently.
        pooled = min(self._num_tokens(text.rstrip() + AFTER), len(tokens))
        ids = torch.tensor([tokens], device=self._device)
        hidden = self._model(input_ids=ids, attention_mask=both_ways(ids, self._model.dtype)).last_hidden_state
        return np.asarray(mean_of_last(hidden[0], pooled).float().cpu().numpy())

    def _num_tokens(self, text: str) -> int:
        return len(self._tokenizer(text, add_special_tokens=False)["input_ids"])


def both_ways(ids: Tensor, dtype: torch.dtype) -> Tensor:
    """The additive attention mask (1, 1, N, N) with which every token of ids (1, N) sees every other.

    It must be given: by default, a Llama's tokens see only those before them.
    """
    return torch.zeros((1, 1, ids.shape[1], ids.shape[1]), dtype=dtype, device=ids.device)


def mean_of_last(hidden: Tensor, count: int) -> Tensor:
    """The mean (W,) over the last `count` tokens of hidden (N, W): the prompt's own, without the markup before."""
    return hidden[-count:].mean(dim=0)


def shortened(text: str, num_tokens: Any) -> str:
    """The text, cut by whole words until it has at most MAX_TEXT_TOKENS; unchanged if it is a single long word."""
    while (count := num_tokens(text)) > MAX_TEXT_TOKENS:
        words = text.split()
        kept = int(len(words) * MAX_TEXT_TOKENS / count)
        if kept < 1:
            return text  # the tokenizer cuts it
        text = " ".join(words[:kept])
    return text


def _load(folders: Llm2VecFolders, dtype: torch.dtype) -> tuple[PreTrainedTokenizerBase, LlamaModel]:
    from peft import PeftModel, get_peft_model_state_dict
    from safetensors import safe_open
    from transformers import AutoTokenizer, LlamaModel

    # If the first adapter has its own tokenizer, it was trained with that.
    with_tokenizer = next((each for each in folders.adapters if (each / "tokenizer.json").is_file()), folders.llama)
    tokenizer = AutoTokenizer.from_pretrained(with_tokenizer, local_files_only=True, trust_remote_code=False)
    model: Any
    model, report = LlamaModel.from_pretrained(
        folders.llama, dtype=dtype, local_files_only=True, use_safetensors=True, output_loading_info=True
    )
    # Both libraries initialise missing weights randomly, and only warn.
    _check_complete(folders.llama, missing=report["missing_keys"])
    for adapter in folders.adapters:
        weights = adapter / "adapter_model.safetensors"
        if not weights.is_file():
            raise UnknownTextEncoder(f"{weights} is missing; an adapter in another form is not read")
        model = PeftModel.from_pretrained(model, adapter, local_files_only=True)
        with safe_open(weights, framework="numpy") as file:
            stored = set(file.keys())
        wanted = set(get_peft_model_state_dict(model, save_embedding_layers=False))
        _check_complete(adapter, missing=wanted - stored, unknown=stored - wanted)
        model = model.merge_and_unload()
    model.eval()
    return tokenizer, model


def _check_complete(folder: Path, missing: Iterable[str], unknown: Iterable[str] = ()) -> None:
    """Raise UnknownTextEncoder if a folder's weights are not those that its configuration describes."""
    parts = [
        f"{what} {', '.join(sorted(names)[:4])}" for what, names in (("lacks", missing), ("has", unknown)) if names
    ]
    if parts:
        raise UnknownTextEncoder(
            f"the weights in {folder} are not those of its configuration: it {' and '.join(parts)}"
        )


def find_folders(second: str = SECOND_ADAPTER, first: str = FIRST_ADAPTER) -> Llm2VecFolders:
    """The folders of the released encoder: in $TEXT_ENCODERS_DIR, else from the Hugging Face hub and its cache.

    Raises UnknownTextEncoder.
    """
    adapter = _find(first, "adapter")
    try:
        llama = json.loads((adapter / "adapter_config.json").read_text(encoding="utf-8"))["base_model_name_or_path"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnknownTextEncoder(
            f"{adapter} is no adapter: it has no adapter_config.json that names a model"
        ) from error
    return Llm2VecFolders(_find(str(llama), "model"), (adapter, _find(second, "adapter")))


def _find(name: str, kind: str) -> Path:
    home = os.environ.get(FOLDERS_VARIABLE)
    is_inside = not Path(name).is_absolute() and ".." not in Path(name).parts
    if home and is_inside and (Path(home) / name).is_dir():
        return Path(home) / name
    try:
        return fetch_files(name, MODEL_FILES, by_hand=f"put the files into ${FOLDERS_VARIABLE}/{name}")
    except HubError as error:
        raise UnknownTextEncoder(f"llm2vec lacks its {kind} {name}: {error}") from error


def fingerprint(folders: Llm2VecFolders) -> str:
    """12 hexadecimal digits that change with the folders' content: a hash of each file's size, beginning and end."""
    digest = hashlib.sha256()
    for folder in (folders.llama, *folders.adapters):
        for path in sorted(
            {*folder.glob("*.safetensors"), *(folder / name for name in SETTINGS)} & {*folder.iterdir()}
        ):
            with path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                file.seek(0)
                digest.update(f"{path.name} {size}\n".encode() + file.read(SAMPLE_BYTES))
                file.seek(max(0, size - SAMPLE_BYTES))
                digest.update(file.read(SAMPLE_BYTES))
    return digest.hexdigest()[:12]
