"""Writes a ModelConfig as the `config.yaml` of a checkpoint, in the released layout."""

from __future__ import annotations

from typing import Any

from motiongen_ardy.checkpoint.config import (
    DENOISER_CLASSES,
    DENOISER_FILE,
    GUIDANCE_TYPES,
    MOTION_STATS,
    SKELETON_CLASSES,
    TOKENIZER_CLASSES,
    TOKENIZER_FILE,
    read_model_config,
    read_tokenizer_config,
)
from motiongen_ardy.model.config import (
    ConfigError,
    DenoiserConfig,
    ModelConfig,
    TokenizerConfig,
    TransformerConfig,
)

FOLDER = "${oc.select:checkpoint_dir}"


def write_model_config(config: ModelConfig) -> dict[str, Any]:
    """The mapping to write as `config.yaml`, from which `read_model_config` restores `config`, except for its dropout,
    which matters in training alone. Raises ConfigError for a skeleton for which there is no checkpoint format.
    """
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


def write_tokenizer_config(config: TokenizerConfig, skeleton: str, fps: int) -> dict[str, Any]:
    """The mapping that `read_tokenizer_config` reads. Raises as `write_model_config` does."""
    return {"autoencoder": _write_tokenizer(config) | {"motion_rep": _write_motion_rep(skeleton, fps)}}


def check_model_config(config: ModelConfig) -> None:
    """Raise ConfigError for a model whose checkpoint could not be written or read: before hours of training."""
    read_model_config(write_model_config(config))


def check_tokenizer_config(config: TokenizerConfig, skeleton: str, fps: int) -> None:
    """As `check_model_config`, for a tokenizer alone."""
    read_tokenizer_config(write_tokenizer_config(config, skeleton, fps))


def _write_motion_rep(skeleton: str, fps: int) -> dict[str, Any]:
    name = {ours: theirs for theirs, ours in SKELETON_CLASSES.items()}.get(skeleton)
    if name is None:
        known = ", ".join(SKELETON_CLASSES.values())
        raise ConfigError(f"no checkpoint holds a model of the skeleton {skeleton}; give motion of {known}")
    return {
        "_target_": "ardy.motion_rep.ArdyMotionRep",
        "fps": fps,
        "stats_path": f"{FOLDER}/{MOTION_STATS}/",
        "skeleton": {"_target_": f"ardy.skeleton.{name}"},
    }


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


def _write_denoiser(config: DenoiserConfig) -> dict[str, Any]:
    name = {count: key for key, count in DENOISER_CLASSES.items()}[config.num_stages]
    return {
        "_target_": f"ardy.model.auto_latent_twostage_denoiser.{name}",
        "motion_mask_mode": "concat" if config.constraints else None,
        "num_frames_per_token": config.patch,
        "nframe_root_dim": config.root_token_width,
        "latent_embedding_dim": config.latent_dim,
        "llm_shape": [config.text_tokens, config.text_dim],
        "use_text_mask": config.use_text_mask,
        "input_first_heading_angle": config.heading_token,
        "positional_encoding_mode": config.positions,
        "ckpt_path": f"{FOLDER}/{DENOISER_FILE}",
    } | _write_transformer(config.transformer)


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
        "num_frames_per_token": config.patch,
        "causal_encoder": config.causal_encoder,
        "causal_decoder": config.causal_decoder,
        "ckpt_path": f"{FOLDER}/{TOKENIZER_FILE}",
    } | _write_transformer(config.transformer)
