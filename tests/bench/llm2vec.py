"""Compare LLM2Vec with a second implementation, on a tiny random Llama: `python -m tests.bench.llm2vec`.

Needs the extra motiongen-ardy[llm2vec]. The weights are random, so this shows that tokens are masked and pooled,
adapters merged, prompts cut and precisions kept correctly; not that the released weights keep their meaning.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors

from motiongen_ardy.text import UnknownTextEncoder
from motiongen_ardy.text.llm2vec import AFTER, BEFORE, Llm2VecEncoder, Llm2VecFolders

SPECIAL = ("<|begin_of_text|>", "<|start_header_id|>", "<|end_header_id|>", "<|eot_id|>")
PROMPT = "a person walks forward"


def make_folders(home: Path) -> Llm2VecFolders:
    """A Llama of two layers, with a tokenizer of bytes and a few special tokens, and two adapters."""
    from peft import LoraConfig, get_peft_model
    from transformers import LlamaConfig, LlamaModel, PreTrainedTokenizerFast

    alphabet = pre_tokenizers.ByteLevel.alphabet()
    vocabulary = {sign: number for number, sign in enumerate([*SPECIAL, *sorted(alphabet)])}
    tokenizer = Tokenizer(models.BPE(vocabulary, []))
    tokenizer.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    tokenizer.decoder = decoders.ByteLevel()
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<|begin_of_text|> $A", special_tokens=[("<|begin_of_text|>", 0)]
    )
    fast = PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, bos_token=SPECIAL[0], eos_token=SPECIAL[3], extra_special_tokens=list(SPECIAL[1:3])
    )
    torch.manual_seed(1)
    config = LlamaConfig(
        vocab_size=len(vocabulary), hidden_size=64, intermediate_size=96, num_hidden_layers=2, num_attention_heads=4,
        num_key_value_heads=2, max_position_embeddings=1024,
    )  # fmt: skip
    llama = LlamaModel(config)
    llama.save_pretrained(home / "llama")
    fast.save_pretrained(home / "llama")
    adapters = []
    for name in ("first", "second"):
        adapted: Any = get_peft_model(
            LlamaModel.from_pretrained(home / "llama"),
            LoraConfig(r=4, target_modules=["q_proj", "v_proj", "down_proj"], base_model_name_or_path="llama"),
        )
        for parameter_name, parameter in adapted.named_parameters():
            if "lora" in parameter_name:
                torch.nn.init.normal_(parameter, std=0.3)
        adapted.save_pretrained(home / name)
        adapters.append(home / name)
    return Llm2VecFolders(home / "llama", tuple(adapters))


def by_hand(folders: Llm2VecFolders, prompt: str) -> np.ndarray:
    """The same vector, computed with adapters as products of their factors and with attention written out."""
    from safetensors.torch import load_file
    from transformers import AutoTokenizer, LlamaModel

    tokenizer = AutoTokenizer.from_pretrained(folders.llama)
    model = LlamaModel.from_pretrained(folders.llama, dtype=torch.float32)
    weights = dict(model.named_parameters())
    for adapter in folders.adapters:
        settings = json.loads((adapter / "adapter_config.json").read_text())
        factors = load_file(adapter / "adapter_model.safetensors")
        for name, down in factors.items():
            if name.endswith("lora_A.weight"):
                target = name.removeprefix("base_model.model.").removesuffix(".lora_A.weight") + ".weight"
                up = factors[name.replace("lora_A", "lora_B")]
                weights[target].data += settings["lora_alpha"] / settings["r"] * (up @ down)
    ids = tokenizer(BEFORE + prompt + AFTER)["input_ids"]
    pooled = len(tokenizer(prompt + AFTER, add_special_tokens=False)["input_ids"])
    config = model.config
    num_heads, num_groups, width = config.num_attention_heads, config.num_key_value_heads, config.hidden_size
    size = width // num_heads
    hidden = model.embed_tokens(torch.tensor(ids))
    position = torch.arange(len(ids))[:, None]
    angle = position * config.rope_parameters["rope_theta"] ** (-torch.arange(0, size, 2) / size)
    cos, sin = angle.cos().repeat(1, 2), angle.sin().repeat(1, 2)

    def turned(x: torch.Tensor) -> torch.Tensor:
        first, second = x.chunk(2, dim=-1)
        return x * cos + torch.cat([-second, first], dim=-1) * sin

    for layer in model.layers:
        normed = layer.input_layernorm(hidden)
        attention = layer.self_attn
        queries = attention.q_proj(normed).view(-1, num_heads, size).transpose(0, 1)
        keys = attention.k_proj(normed).view(-1, num_groups, size).transpose(0, 1)
        values = attention.v_proj(normed).view(-1, num_groups, size).transpose(0, 1)
        keys, values = (x.repeat_interleave(num_heads // num_groups, 0) for x in (turned(keys), values))
        seen = torch.softmax(turned(queries) @ keys.transpose(1, 2) / size**0.5, dim=-1) @ values  # all see all
        hidden = hidden + attention.o_proj(seen.transpose(0, 1).reshape(len(ids), width))
        hidden = hidden + layer.mlp(layer.post_attention_layernorm(hidden))
    hidden = model.norm(hidden)
    return hidden[-pooled:].mean(0).detach().numpy()


def refusals(folders: Llm2VecFolders) -> int:
    """How many of four broken encoders are loaded although they should be refused."""
    from safetensors.torch import load_file, save_file

    second = folders.adapters[1] / "adapter_model.safetensors"
    llama = folders.llama / "model.safetensors"
    taken = 0
    for path, change in ((second, "lack"), (second, "more"), (llama, "lack"), (second, "gone")):
        whole = load_file(path)
        names = sorted(name for name in whole if "layers.1" in name)
        broken = {name: tensor for name, tensor in whole.items() if change != "lack" or name != names[0]}
        if change == "more":
            broken["base_model.model.layers.7.self_attn.q_proj.lora_A.weight"] = whole[names[0]].clone()
        save_file(broken, path, {"format": "pt"})
        if change == "gone":
            path.unlink()
        try:
            Llm2VecEncoder(folders, precision="float32")
            taken += 1
        except UnknownTextEncoder as refused:
            print(f"      refused: {str(refused).replace(str(path.parent), path.parent.name)}")
        save_file(whole, path, {"format": "pt"})
    return taken


def check(what: str, found: float, most: float) -> bool:
    verdict = "ok" if found <= most else "WRONG"
    print(f"{verdict:6}{what}: {found:.2e} (at most {most:.0e})")
    return found <= most


def main() -> int:
    argparse.ArgumentParser(prog="python -m tests.bench.llm2vec", description=__doc__).parse_args()
    with tempfile.TemporaryDirectory() as home:
        folders = make_folders(Path(home))
        encoder = Llm2VecEncoder(folders, precision="float32")
        alone = encoder.encode([PROMPT])[0]
        scale = float(np.abs(alone).mean())
        half = Llm2VecEncoder(folders, precision="bfloat16")
        together = encoder.encode(["a person jumps", PROMPT, " \n"])
        other_end = encoder.encode([PROMPT + "s"])[0]
        longest = encoder.encode(["walks " * 300])[0]
        cut = encoder.encode([" ".join(["walks"] * next(n for n in range(300, 0, -1) if 6 * n - 1 <= 400))])[0]
        results = [
            check("off the vector computed by hand", float(np.abs(alone - by_hand(folders, PROMPT)).max()), 1e-5),
            check("changed by other prompts of its batch", float(np.abs(together[1] - alone).max()), 0),
            check("a blank prompt's vector", float(np.abs(together[2]).max()), 0),
            check("trailing space", float(np.abs(encoder.encode([PROMPT + "  "])[0] - alone).max()), 0),
            check(
                "bfloat16 off float32, relative", float(np.abs(half.encode([PROMPT])[0] - alone).mean()) / scale, 0.05
            ),
            check("the last letter must matter", 1e-3 / float(np.abs(other_end - alone).max()), 1),
            check("a prompt too long, cut by words", float(np.abs(longest - cut).max()) if cut.any() else 1, 1e-5),
        ]
        results.append(check("broken encoders that are accepted", refusals(folders), 0))
        print(f"identities {encoder.identity} and {half.identity}")
        results.append(encoder.identity != half.identity)
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
