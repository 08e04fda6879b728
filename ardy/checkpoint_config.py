"""`config.yaml` of a checkpoint <-> ModelConfig, in the released layout.

A `_target_` names a class by its last component, which is looked up in fixed tables: nothing it names is imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from ardy.config import (
    FRAMES_PER_TOKEN,
    ConfigError,
    DenoiserConfig,
    GuidanceMode,
    ModelConfig,
    TokenizerConfig,
    TokenizerKind,
    TransformerConfig,
)

SKELETON_CLASSES = {
    "CoreSkeleton27": "core27",
    "G1Skeleton34": "g134",
    "SOMASkeleton30": "soma30",
}
TOKENIZER_CLASSES: dict[str, TokenizerKind] = {
    "FSQVAETransformer": "fsq",
    "AETransformer": "ae",
    "VAETransformer": "vae",
}
DENOISER_CLASSES: dict[str, Literal[1, 2]] = {"AutoLatentTwostageDenoiser": 2, "AutoLatentOnestageDenoiser": 1}
GUIDANCE_TYPES: dict[str, GuidanceMode] = {"separated": "separated", "regular": "regular", "nocfg": "none"}

MODEL_KEYS = {
    "_target_", "denoiser", "autoencoder", "gen_horizon_len", "num_base_steps", "cfg_type", "text_encoder", "device",
    "checkpoint_dir",
}  # fmt: skip
DENOISER_KEYS = {
    "_target_", "motion_rep", "motion_mask_mode", "num_frames_per_token", "nframe_root_dim", "latent_embedding_dim",
    "ckpt_path", "sparsify_token_seq", "trt_compatible", "llm_shape", "use_text_mask", "latent_dim", "ff_size",
    "num_layers", "num_heads", "activation", "dropout", "pe_dropout", "norm_first", "input_first_heading_angle",
    "positional_encoding_mode",
}  # fmt: skip
NUM_ROOT_NUMBERS = 5 * FRAMES_PER_TOKEN


def read_model_config(content: object) -> ModelConfig:
    """The configuration that a parsed `config.yaml` describes.

    Raises ConfigError naming the key for a missing or unknown key, another `_target_`, or a value outside its range.
    Unknown keys of `autoencoder` and `motion_rep` are ignored, as the released files' loader does.
    """
    top = _mapping(content, "config.yaml")
    _refuse_unknown(top, MODEL_KEYS, "config.yaml")
    _class_of(top, "config.yaml", ("Ardy",))
    denoiser = _mapping(_required(top, "denoiser", "config.yaml"), "denoiser")
    _refuse_unknown(denoiser, DENOISER_KEYS, "denoiser")
    autoencoder = top.get("autoencoder")
    skeleton, fps = _read_motion_rep(denoiser, "denoiser")
    guidance = str(top.get("cfg_type", "regular") or "nocfg")
    if guidance not in GUIDANCE_TYPES:
        raise ConfigError(f"cfg_type is {guidance!r}; it must be one of {', '.join(GUIDANCE_TYPES)}")
    return ModelConfig(
        skeleton=skeleton,
        fps=fps,
        horizon=_integer(top, "gen_horizon_len", "config.yaml"),
        num_base_steps=_integer(top, "num_base_steps", "config.yaml"),
        guidance=GUIDANCE_TYPES[guidance],
        denoiser=_read_denoiser(denoiser),
        tokenizer=None if autoencoder is None else _read_tokenizer(_mapping(autoencoder, "autoencoder")),
    )


def write_model_config(config: ModelConfig) -> dict[str, Any]:
    """The mapping to write as `config.yaml`, such that `read_model_config` returns `config` again."""
    motion_rep = _write_motion_rep(config.skeleton, config.fps)
    guidance = {name: key for key, name in GUIDANCE_TYPES.items()}[config.guidance]
    content: dict[str, Any] = {
        "_target_": "ardy.model.Ardy",
        "cfg_type": guidance,
        "num_base_steps": config.num_base_steps,
        "gen_horizon_len": config.horizon,
        "text_encoder": None,
        "denoiser": _write_denoiser(config.denoiser) | {"motion_rep": motion_rep},
    }
    if config.tokenizer is not None:
        content["autoencoder"] = _write_tokenizer(config.tokenizer) | {"motion_rep": motion_rep}
    return content


def read_tokenizer_config(content: object) -> tuple[TokenizerConfig, str, int]:
    """The tokenizer that a parsed `config.yaml` describes, with its skeleton's name and its frame rate.

    Needs the `autoencoder` section only, which is all that a folder with a tokenizer and no denoiser has.
    """
    top = _mapping(content, "config.yaml")
    section = _mapping(_required(top, "autoencoder", "config.yaml"), "autoencoder")
    return _read_tokenizer(section), *_read_motion_rep(section, "autoencoder")


def write_tokenizer_config(config: TokenizerConfig, skeleton: str, fps: int) -> dict[str, Any]:
    """The mapping that `read_tokenizer_config` reads."""
    return {"autoencoder": _write_tokenizer(config) | {"motion_rep": _write_motion_rep(skeleton, fps)}}


def _read_motion_rep(section: Mapping[str, Any], where: str) -> tuple[str, int]:
    where = f"{where}.motion_rep"
    motion_rep = _mapping(_required(section, "motion_rep", where), where)
    skeleton = _mapping(_required(motion_rep, "skeleton", where), f"{where}.skeleton")
    name = _class_of(skeleton, f"{where}.skeleton", tuple(SKELETON_CLASSES))
    return SKELETON_CLASSES[name], _integer(motion_rep, "fps", where)


def _write_motion_rep(skeleton: str, fps: int) -> dict[str, Any]:
    name = {ours: theirs for theirs, ours in SKELETON_CLASSES.items()}[skeleton]
    return {
        "_target_": "ardy.motion_rep.ArdyMotionRep",
        "fps": fps,
        "stats_path": "${oc.select:checkpoint_dir}/stats/motion/",
        "skeleton": {"_target_": f"ardy.skeleton.{name}"},
    }


def _read_transformer(section: Mapping[str, Any], where: str) -> TransformerConfig:
    return TransformerConfig(
        width=_integer(section, "latent_dim", where),
        feed_forward=_integer(section, "ff_size", where),
        num_layers=_integer(section, "num_layers", where),
        num_heads=_integer(section, "num_heads", where),
        activation=str(section.get("activation", "gelu")),
        norm_first=bool(section.get("norm_first", False)),
    )


def _write_transformer(config: TransformerConfig) -> dict[str, Any]:
    return {
        "latent_dim": config.width,
        "ff_size": config.feed_forward,
        "num_layers": config.num_layers,
        "num_heads": config.num_heads,
        "activation": config.activation,
        "dropout": 0.0,
        "pe_dropout": 0.0,
        "norm_first": config.norm_first,
    }


def _read_denoiser(section: Mapping[str, Any]) -> DenoiserConfig:
    where = "denoiser"
    num_stages = DENOISER_CLASSES[_class_of(section, where, tuple(DENOISER_CLASSES))]
    _require_value(section, "num_frames_per_token", FRAMES_PER_TOKEN, where)
    _require_value(section, "nframe_root_dim", NUM_ROOT_NUMBERS, where)
    mask_mode = section.get("motion_mask_mode", "concat")
    if mask_mode not in ("concat", None):
        raise ConfigError(f"denoiser.motion_mask_mode is {mask_mode!r}; it must be concat or null")
    shape = section.get("llm_shape")
    if not isinstance(shape, list) or len(shape) != 2 or not all(isinstance(number, int) for number in shape):
        raise ConfigError(f"denoiser.llm_shape is {shape!r}; it must be [text tokens, text width]")
    positions = section.get("positional_encoding_mode", "default")
    return DenoiserConfig(
        transformer=_read_transformer(section, where),
        latent_dim=_integer(section, "latent_embedding_dim", where),
        text_tokens=shape[0],
        text_dim=shape[1],
        use_text_mask=bool(section.get("use_text_mask", False)),
        heading_token=bool(section.get("input_first_heading_angle", False)),
        constraints=mask_mode == "concat",
        positions=positions,
        num_stages=num_stages,
    )


def _write_denoiser(config: DenoiserConfig) -> dict[str, Any]:
    name = {count: key for key, count in DENOISER_CLASSES.items()}[config.num_stages]
    return {
        "_target_": f"ardy.model.auto_latent_twostage_denoiser.{name}",
        "motion_mask_mode": "concat" if config.constraints else None,
        "num_frames_per_token": FRAMES_PER_TOKEN,
        "nframe_root_dim": NUM_ROOT_NUMBERS,
        "latent_embedding_dim": config.latent_dim,
        "llm_shape": [config.text_tokens, config.text_dim],
        "use_text_mask": config.use_text_mask,
        "input_first_heading_angle": config.heading_token,
        "positional_encoding_mode": config.positions,
        "ckpt_path": "${oc.select:checkpoint_dir}/denoiser.safetensors",
    } | _write_transformer(config.transformer)


def _read_tokenizer(section: Mapping[str, Any]) -> TokenizerConfig:
    where = "autoencoder"
    kind = TOKENIZER_CLASSES[_class_of(section, where, tuple(TOKENIZER_CLASSES))]
    _require_value(section, "num_frames_per_token", FRAMES_PER_TOKEN, where)
    modes = section.get("feature_mode", ["body", "pose", "body", "root"])
    if modes not in (["body", "pose", "body", "root"], ["body", "pose", "body", "global_root"]):
        raise ConfigError(
            f"autoencoder.feature_mode is {modes!r}; it must be [body, pose, body, root], or with global_root last"
        )
    latent_dim = _integer(section, "num_fsq_levels", where)
    levels = section.get("fsq_level_list", 64)
    return TokenizerConfig(
        transformer=_read_transformer(section, where),
        latent_dim=latent_dim,
        levels=tuple(levels) if isinstance(levels, list) else (int(levels),) * latent_dim,
        kind=kind,
        normalize_latents=bool(section.get("encode_with_normalization", True)),
        quantize_on_encode=bool(section.get("encode_with_quantization", True)),
        causal_encoder=bool(section.get("causal_encoder", True)),
        causal_decoder=bool(section.get("causal_decoder", True)),
        global_root=modes[3] == "global_root",
    )


def _write_tokenizer(config: TokenizerConfig) -> dict[str, Any]:
    name = {kind: key for key, kind in TOKENIZER_CLASSES.items()}[config.kind]
    same = len(set(config.levels)) == 1
    return {
        "_target_": f"ardy.model.autoencoder.{config.kind}.{name}",
        "feature_mode": ["body", "pose", "body", "global_root" if config.global_root else "root"],
        "num_fsq_levels": config.latent_dim,
        "fsq_level_list": config.levels[0] if same else list(config.levels),
        "encode_with_normalization": config.normalize_latents,
        "encode_with_quantization": config.quantize_on_encode,
        "latent_embedding_dim": config.latent_dim,
        "num_frames_per_token": FRAMES_PER_TOKEN,
        "causal_encoder": config.causal_encoder,
        "causal_decoder": config.causal_decoder,
        "ckpt_path": "${oc.select:checkpoint_dir}/tokenizer.safetensors",
    } | _write_transformer(config.transformer)


def _mapping(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where} is {value!r}; it must be a mapping")
    return value


def _required(section: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in section:
        raise ConfigError(f"{where} lacks the key {key}; it has {', '.join(map(str, section))}")
    return section[key]


def _integer(section: Mapping[str, Any], key: str, where: str) -> int:
    value = _required(section, key, where)
    if not isinstance(value, int) or isinstance(value, bool):
        raise ConfigError(f"{where}.{key} is {value!r}; it must be a whole number")
    return value


def _require_value(section: Mapping[str, Any], key: str, expected: int, where: str) -> None:
    value = _integer(section, key, where)
    if value != expected:
        raise ConfigError(f"{where}.{key} is {value}; only {expected} is supported")


def _refuse_unknown(section: Mapping[str, Any], known: set[str], where: str) -> None:
    unknown = sorted(str(key) for key in section if key not in known)
    if unknown:
        raise ConfigError(f"{where} has unknown keys {', '.join(unknown)}; known keys are {', '.join(sorted(known))}")


def _class_of(section: Mapping[str, Any], where: str, allowed: tuple[str, ...]) -> str:
    target = str(_required(section, "_target_", where))
    name = target.rpartition(".")[2]
    if name not in allowed:
        raise ConfigError(f"{where}._target_ is {target!r}; its last part must be one of {', '.join(allowed)}")
    return name
