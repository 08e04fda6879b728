"""TextJudge: how well a motion and a text match, by two small encoders that are trained to agree.

A GRU reads a motion as a sequence of frames, 10 a second, relative to its start. Two layers transform a text's static
embedding. Both end on the unit sphere of `DIM` dimensions, as in TMR (Petrovich et al. 2023), but without its decoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.rnn import pack_padded_sequence

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.representation import Representation

DIM = 64
HIDDEN = 128
STRIDE = 2
MAX_FRAMES = 120
# Of the judge included in the package, whose file does not say so.
JUDGE_FPS = 20
JUDGE_TEXTS = "static-b8a02ae25cd7"
FOLDER = Path(__file__).parent / "text_judge"
WEIGHTS_FILE = "judge.safetensors"


class JudgeMissing(ValueError):
    """Raised if the judge's weights cannot be read or do not fit."""


class TextJudge(nn.Module):
    """The two encoders. frame_dim: width of `judge_frames`; text_dim: of the text embeddings.

    fps: frame rate of the motions that it was trained on; text_encoder: identity of the encoder of the embeddings that
    it was trained on; "" if unknown.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, frame_dim: int, text_dim: int, fps: int = JUDGE_FPS, text_encoder: str = "") -> None:
        super().__init__()
        self.fps, self.text_encoder = fps, text_encoder
        self.register_buffer("mean", torch.zeros(frame_dim))
        self.register_buffer("std", torch.ones(frame_dim))
        self.frame = nn.Sequential(nn.Linear(frame_dim, HIDDEN), nn.GELU())
        self.gru = nn.GRU(HIDDEN, HIDDEN, batch_first=True, bidirectional=True)
        self.motion = nn.Linear(4 * HIDDEN, DIM)
        self.text = nn.Sequential(nn.Linear(text_dim, 2 * HIDDEN), nn.GELU(), nn.Linear(2 * HIDDEN, DIM))
        self.log_scale = nn.Parameter(torch.tensor(2.3))

    def motions(self, frames: Tensor, lengths: Tensor) -> Tensor:
        """Unit vectors (B, DIM) of frames (B, T, F) from `judge_frames`, of which lengths (B) are valid."""
        hidden = self.frame((frames - self.mean) / self.std)
        packed = pack_padded_sequence(hidden, lengths.cpu(), batch_first=True, enforce_sorted=False)
        steps, last = self.gru(packed)
        steps, _ = nn.utils.rnn.pad_packed_sequence(steps, batch_first=True, total_length=frames.shape[1])
        mean = steps.sum(dim=1) / lengths[:, None]
        return functional.normalize(self.motion(torch.cat([mean, last[0], last[1]], dim=-1)), dim=-1)

    def texts(self, embeddings: Tensor) -> Tensor:
        """Unit vectors (B, DIM) of text embeddings (B, W)."""
        return functional.normalize(self.text(embeddings), dim=-1)

    @torch.no_grad()
    def embed(self, layout: Representation, motions: Sequence[Tensor], batch: int = 64) -> Tensor:
        """Unit vectors (N, DIM) of features (T, D) in natural units; only the first MAX_FRAMES frames of each count."""
        rows = [judge_frames(layout, features[:MAX_FRAMES]) for features in motions]
        parts = []
        for first in range(0, len(rows), batch):
            group = rows[first : first + batch]
            lengths = torch.tensor([len(row) for row in group])
            parts.append(self.motions(nn.utils.rnn.pad_sequence(group, batch_first=True), lengths))
        return torch.cat(parts)


def judge_frames(layout: Representation, features: Tensor) -> Tensor:
    """Every second frame of features (T, D) in natural units, turned and moved to start facing +Z at the origin.

    Contains root, heading, positions and velocities, but no rotations and contacts.
    """
    told = layout.canonicalize(features[None])[0, ::STRIDE]
    return torch.cat([told[:, : layout.position_block.stop], told[:, layout.velocity_block]], dim=-1)


def frame_dim(layout: Representation) -> int:
    """The width of `judge_frames`."""
    return layout.position_block.stop + layout.velocity_block.stop - layout.velocity_block.start


def save_judge(judge: TextJudge, folder: Path) -> None:
    """Write the weights as float16, which halves the file, with the judge's frame rate and text encoder."""
    folder.mkdir(parents=True, exist_ok=True)
    tensors = {name: value.half().contiguous() for name, value in judge.state_dict().items()}
    with written_whole(folder / WEIGHTS_FILE) as partial:
        save_file(tensors, partial, {"fps": str(judge.fps), "text_encoder": judge.text_encoder})


def load_judge(layout: Representation, text_dim: int, folder: Path = FOLDER, text_encoder: str = "") -> TextJudge:
    """The judge in a folder, by default the one included in the package. text_encoder: the identity of the model's.

    Raises JudgeMissing for a folder without readable weights, or with those for another skeleton, frame rate or text
    encoder.
    """
    path = folder / WEIGHTS_FILE
    wanted = f"{layout.skeleton.name} at {layout.fps} frames a second and texts of width {text_dim}"
    train = "train one with `python -m motiongen_ardy.evaluate.judge_training DATA FOLDER` and name it with --judge"
    judge = TextJudge(frame_dim(layout), text_dim)
    try:
        with safe_open(path, "pt") as file:
            told = file.metadata() or {}
        judge.load_state_dict({name: value.float() for name, value in load_file(path).items()})
        judge.fps, judge.text_encoder = int(told.get("fps", JUDGE_FPS)), told.get("text_encoder", JUDGE_TEXTS)
    except (OSError, RuntimeError, ValueError, SafetensorError) as error:
        raise JudgeMissing(f"{path} is no judge for {wanted}: {' '.join(str(error).split())}; {train}") from error
    if judge.fps != layout.fps:
        raise JudgeMissing(f"{path} is no judge for {wanted}: it knows motion at {judge.fps}; {train}")
    if text_encoder and judge.text_encoder not in ("", text_encoder):
        raise JudgeMissing(f"{path} is no judge for {wanted}: it knows texts by {judge.text_encoder}; {train}")
    return judge.eval()
