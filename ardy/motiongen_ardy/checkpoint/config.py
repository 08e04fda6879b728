"""`config.yaml` of a checkpoint -> ModelConfig, in the released layout.

A `_target_` names a class by its last component, which is looked up in fixed tables: nothing that it names is imported.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from motiongen_ardy.checkpoint.config_section import Section, shown
from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.config import (
    MAX_PATCH,
    ConfigError,
    DenoiserConfig,
    GuidanceMode,
    ModelConfig,
    PositionMode,
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
GUIDANCE_TYPES: dict[str | None, GuidanceMode] = {
    "separated": "separated", "regular": "regular", None: "none", "nocfg": "none",
}  # fmt: skip
POSITION_MODES: dict[str | None, PositionMode] = {
    "learned_prefix_zero_at_first_generation": "learned_prefix_zero_at_first_generation", "default": "default",
}  # fmt: skip

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


# Far beyond any released model; these keep a config from requesting more than any file beside it could fill.
MAX_FPS = 1000
MAX_HORIZON = 2048
MAX_BASE_STEPS = 1000
MAX_WIDTH = 1 << 13
MAX_LAYERS = 256
MAX_LEVELS = 1 << 16
MAX_TEXT_TOKENS = 1024

DENOISER_FILE = "denoiser.safetensors"
TOKENIZER_FILE = "tokenizer.safetensors"
MOTION_STATS = "stats/motion"
MAX_PATH = 1024
RELEASED_MODES = ["body", "pose", "body", "root"]
GLOBAL_ROOT_MODES = ["body", "pose", "body", "global_root"]
FOLDER_FORMS = re.compile(r"^\$\{(oc\.select:)?\s*checkpoint_dir\s*(,[^}]*)?\}/*")


@dataclass(frozen=True)
class FolderLayout:
    """Where the parts of a checkpoint are: paths relative to its folder, separated by /."""

    denoiser: str = DENOISER_FILE
    tokenizer: str = TOKENIZER_FILE
    motion_stats: str = MOTION_STATS

    @property
    def latent_stats(self) -> str:
        """The folder of the tokenizer's statistics: `stats` beside its weights."""
        return f"{self.tokenizer.rpartition('/')[0]}/stats".removeprefix("/")


def read_model_config(content: object) -> tuple[ModelConfig, FolderLayout]:
    """The configuration that a parsed `config.yaml` describes, and where it says that weights and statistics are.

    Raises ConfigError listing every problem: missing or unknown keys, another `_target_`, values outside their range.
    Unknown keys of `autoencoder` and `motion_rep` are ignored, as by the released files' own loader.
    """
    problems: list[str] = []
    top = Section(content, "config.yaml", problems)
    top.refuse_unknown(MODEL_KEYS)
    top.target(("Ardy",))
    denoiser, autoencoder = top.section("denoiser"), None
    if top.content.get("autoencoder") is not None:
        autoencoder = top.section("autoencoder")
    guidance = GUIDANCE_TYPES[top.choice("cfg_type", tuple(GUIDANCE_TYPES), "regular")]
    horizon = top.integer("gen_horizon_len", MAX_HORIZON)
    base_steps = top.integer("num_base_steps", MAX_BASE_STEPS)
    denoiser_config = motion = layout = None
    if denoiser is not None:
        denoiser.refuse_unknown(DENOISER_KEYS)
        motion = _read_motion_rep(denoiser)
        denoiser_config = _read_denoiser(denoiser)
        layout = _read_layout(denoiser, autoencoder, motion)
    tokenizer_config = None if autoencoder is None else _read_tokenizer(autoencoder)
    if autoencoder is not None:
        its_motion = _read_motion_rep(autoencoder)
        if motion and its_motion and motion != its_motion:
            problems.append(
                f"denoiser.motion_rep says {motion} and autoencoder.motion_rep {its_motion}; both must agree"
            )
    if problems or not (motion and denoiser_config and layout and horizon and base_steps):
        raise ConfigError(problems)
    return ModelConfig(
        skeleton=motion.skeleton,
        fps=motion.fps,
        horizon=horizon,
        num_base_steps=base_steps,
        guidance=guidance,
        denoiser=denoiser_config,
        tokenizer=tokenizer_config,
    ), layout


def read_tokenizer_config(content: object) -> tuple[TokenizerConfig, str, int, FolderLayout]:
    """The tokenizer that a parsed `config.yaml` describes, its skeleton's name, frame rate and files.

    Needs only the `autoencoder` section, the only one in a folder with a tokenizer and no denoiser.
    """
    problems: list[str] = []
    section = Section(content, "config.yaml", problems).section("autoencoder")
    motion = config = layout = None
    if section is not None:
        motion = _read_motion_rep(section)
        config = _read_tokenizer(section)
        layout = _read_layout(None, section, motion)
    if problems or not (motion and config and layout):
        raise ConfigError(problems)
    return config, motion.skeleton, motion.fps, layout


@dataclass(frozen=True)
class MotionRep:
    """What denoiser and tokenizer each say about the motion they work on. stats: relative to the folder."""

    skeleton: str
    fps: int
    stats: str

    def __str__(self) -> str:
        return f"{self.skeleton} at {self.fps} frames a second with statistics in {self.stats}"


def _read_motion_rep(part: Section) -> MotionRep | None:
    section = part.section("motion_rep")
    if section is None:
        return None
    section.target(("ArdyMotionRep",))
    fps = section.integer("fps", MAX_FPS)
    skeleton = section.section("skeleton")
    name = None if skeleton is None else skeleton.target(tuple(SKELETON_CLASSES))
    stats = section.content.get("stats_path")
    if stats is None:
        folder = section.content.get("stats")
        stats = folder.get("folder") if isinstance(folder, dict) else None
    path = _relative(section, "stats_path", stats, MOTION_STATS)
    return None if fps is None or name is None or path is None else MotionRep(SKELETON_CLASSES[name], fps, path)


def _read_layout(
    denoiser: Section | None, autoencoder: Section | None, motion: MotionRep | None
) -> FolderLayout | None:
    paths = [
        default if section is None else _relative(section, "ckpt_path", section.content.get("ckpt_path"), default)
        for section, default in ((denoiser, DENOISER_FILE), (autoencoder, TOKENIZER_FILE))
    ]
    if motion is None or paths[0] is None or paths[1] is None:
        return None
    return FolderLayout(paths[0], paths[1], motion.stats)


def _relative(section: Section, key: str, value: object, default: str) -> str | None:
    """A path from the config, relative to the checkpoint folder for which its placeholder stands."""
    if value is None:
        return default
    allowed = f"a path in the checkpoint folder, such as ${{checkpoint_dir}}/{default}"
    path = FOLDER_FORMS.sub("", value).rstrip("/") if isinstance(value, str) and len(value) < MAX_PATH else ""
    leads_out = path.startswith(("/", "~")) or ".." in path.split("/")
    if path and path.isprintable() and not leads_out and not set(path) & set("$\\:"):
        return path
    section.problems.append(f"{section.where}.{key} is {shown(value)}; it must be {allowed}")
    return None


def _read_transformer(section: Section) -> TransformerConfig | None:
    width = section.integer("latent_dim", MAX_WIDTH)
    feed_forward = section.integer("ff_size", MAX_WIDTH)
    num_layers = section.integer("num_layers", MAX_LAYERS)
    num_heads = section.integer("num_heads", MAX_WIDTH)
    activation = section.choice("activation", ("gelu", "relu"), "gelu")
    norm_first = section.boolean("norm_first", False)
    if not (width and feed_forward and num_layers and num_heads and activation):
        return None
    try:
        return TransformerConfig(width, feed_forward, num_layers, num_heads, activation, norm_first)
    except ConfigError as error:
        section.problems += [f"{section.where}: {problem}" for problem in error.problems]
        return None


def _read_denoiser(section: Section) -> DenoiserConfig | None:
    target = section.target(tuple(DENOISER_CLASSES))
    patch = section.integer("num_frames_per_token", MAX_PATCH)
    if patch:
        section.require("nframe_root_dim", ROOT_WIDTH * patch)
    section.require("sparsify_token_seq", False, default=False)
    section.boolean("trt_compatible", True)
    mask_mode = section.choice("motion_mask_mode", ("concat", None), "concat")
    positions = section.choice("positional_encoding_mode", tuple(POSITION_MODES), "default")
    latent_dim = section.integer("latent_embedding_dim", MAX_WIDTH)
    use_text_mask = section.boolean("use_text_mask", False)
    heading_token = section.boolean("input_first_heading_angle", False)
    text = _read_text_shape(section)
    transformer = _read_transformer(section)
    if not (target and patch and latent_dim and text and transformer):
        return None
    return DenoiserConfig(
        transformer=transformer,
        latent_dim=latent_dim,
        text_tokens=text[0],
        text_dim=text[1],
        use_text_mask=use_text_mask,
        heading_token=heading_token,
        constraints=mask_mode == "concat",
        positions=POSITION_MODES[positions],
        num_stages=DENOISER_CLASSES[target],
        patch=patch,
    )


def _read_text_shape(section: Section) -> tuple[int, int] | None:
    shape = section.content.get("llm_shape")
    counts = isinstance(shape, list) and len(shape) == 2 and all(type(number) is int for number in shape)
    if counts and 1 <= shape[0] <= MAX_TEXT_TOKENS and 1 <= shape[1] <= MAX_WIDTH:
        return shape[0], shape[1]
    section.refuse("llm_shape", f"[text tokens, text width], at most [{MAX_TEXT_TOKENS}, {MAX_WIDTH}]")
    return None


def _read_tokenizer(section: Section) -> TokenizerConfig | None:
    target = section.target(tuple(TOKENIZER_CLASSES))
    patch = section.integer("num_frames_per_token", MAX_PATCH)
    modes = section.content.get("feature_mode", RELEASED_MODES)
    if modes not in (RELEASED_MODES, GLOBAL_ROOT_MODES):
        section.refuse("feature_mode", "[body, pose, body, root], or with global_root last")
    latent_dim = section.integer("num_fsq_levels", MAX_WIDTH)
    levels = None if latent_dim is None else _read_levels(section, latent_dim)
    normalize = section.boolean("encode_with_normalization", True)
    quantize = section.boolean("encode_with_quantization", True)
    causal_encoder = section.boolean("causal_encoder", True)
    causal_decoder = section.boolean("causal_decoder", True)
    transformer = _read_transformer(section)
    if not (target and patch and latent_dim and levels and transformer):
        return None
    return TokenizerConfig(
        transformer=transformer,
        latent_dim=latent_dim,
        levels=levels,
        kind=TOKENIZER_CLASSES[target],
        normalize_latents=normalize,
        quantize_on_encode=quantize,
        causal_encoder=causal_encoder,
        causal_decoder=causal_decoder,
        global_root=modes == GLOBAL_ROOT_MODES,
        patch=patch,
    )


def _read_levels(section: Section, latent_dim: int) -> tuple[int, ...] | None:
    """The levels of every latent dimension, from a list or one number for all."""
    levels = section.content.get("fsq_level_list", 64)
    listed = levels if isinstance(levels, list) else [levels] * latent_dim
    if len(listed) == latent_dim and all(type(number) is int and 2 <= number <= MAX_LEVELS for number in listed):
        return tuple(listed)
    section.refuse("fsq_level_list", f"a number of levels from 2 to {MAX_LEVELS}, or a list of {latent_dim} of them")
    return None
