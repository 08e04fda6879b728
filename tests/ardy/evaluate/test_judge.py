"""The judge of text and motion: its vectors, its files, and training that brings matching pairs together."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.evaluate.judge import JudgeMissing, TextJudge, frame_dim, judge_frames, load_judge, save_judge
from motiongen_ardy.evaluate.judge_training import JudgeBatch, contrastive_loss
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.train.feature_bank import natural_layout

LAYOUT = natural_layout(load_skeleton("core27"), 20)


def motion(num_frames: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(num_frames, LAYOUT.feature_dim, generator=generator)


def test_vectors_have_unit_length_and_do_not_depend_on_the_batch() -> None:
    judge = TextJudge(frame_dim(LAYOUT), 16).eval()
    motions = [motion(40, 1), motion(90, 2)]
    together = judge.embed(LAYOUT, motions)
    assert together.norm(dim=-1) == pytest.approx(torch.ones(2), abs=1e-5)
    for row, one in enumerate(motions):
        assert torch.allclose(together[row], judge.embed(LAYOUT, [one])[0], atol=1e-5)


def test_frames_do_not_depend_on_where_a_motion_starts_or_faces() -> None:
    features = motion(40, 3)
    moved = LAYOUT.translate_ground(LAYOUT.rotate(features[None], torch.tensor([1.0])), torch.tensor([[3.0, 4.0]]))[0]
    same = LAYOUT.rotate(features[None], torch.tensor([0.0]))[0]
    assert torch.allclose(judge_frames(LAYOUT, moved), judge_frames(LAYOUT, same), atol=1e-3)


def test_a_saved_judge_is_read_back(tmp_path: Path) -> None:
    judge = TextJudge(frame_dim(LAYOUT), 16).eval()
    save_judge(judge, tmp_path)
    again = load_judge(LAYOUT, 16, tmp_path)
    assert torch.allclose(judge.embed(LAYOUT, [motion(50, 4)]), again.embed(LAYOUT, [motion(50, 4)]), atol=5e-3)


def test_a_missing_judge_or_one_of_another_text_width_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JudgeMissing, match="judge_training"):
        load_judge(LAYOUT, 16, tmp_path)
    save_judge(TextJudge(frame_dim(LAYOUT), 16), tmp_path)
    with pytest.raises(JudgeMissing, match="texts of width 17"):
        load_judge(LAYOUT, 17, tmp_path)


def test_a_judge_of_another_rate_or_encoder_is_refused(tmp_path: Path) -> None:
    """Its figures would be meaningless: it was trained on frames at one rate and vectors of one encoder."""
    with pytest.raises(JudgeMissing, match=r"core27 at 30 frames a second .* it knows motion at 20; train one with"):
        load_judge(natural_layout(load_skeleton("core27"), 30), 256)
    save_judge(TextJudge(frame_dim(LAYOUT), 16, 30, "mine"), tmp_path)
    with pytest.raises(JudgeMissing, match="it knows motion at 30"):
        load_judge(LAYOUT, 16, tmp_path)
    save_judge(TextJudge(frame_dim(LAYOUT), 16, 20, "mine"), tmp_path)
    with pytest.raises(JudgeMissing, match="it knows texts by mine"):
        load_judge(LAYOUT, 16, tmp_path, "another")
    assert load_judge(LAYOUT, 16, tmp_path, "mine").text_encoder == "mine"


def test_training_brings_pairs_together_and_ignores_equal_texts() -> None:
    torch.manual_seed(0)
    judge = TextJudge(6, 8)
    frames, texts = torch.randn(8, 20, 6), torch.randn(8, 8)
    batch = JudgeBatch(frames, torch.full((8,), 20), texts, torch.arange(8))
    optimizer = torch.optim.Adam(judge.parameters(), lr=3e-3)
    first = float(contrastive_loss(judge, batch).detach())
    for _ in range(40):
        optimizer.zero_grad()
        loss = contrastive_loss(judge, batch)
        loss.backward()
        optimizer.step()
    assert float(loss.detach()) < 0.3 * first
    alike = JudgeBatch(frames, batch.lengths, texts, torch.zeros(8, dtype=torch.long))
    assert float(contrastive_loss(judge, alike).detach()) == pytest.approx(0.0, abs=1e-6)


def test_the_built_in_judge_accepts_only_its_text_encoder() -> None:
    judge = load_judge(LAYOUT, 256)
    assert judge.std.min() > 0
    assert judge.text_encoder == load_text_encoder("static").identity
    with pytest.raises(JudgeMissing, match="it knows texts by static-"):
        load_judge(LAYOUT, 256, text_encoder=load_text_encoder("hashed", 256).identity)
    assert sum(value.numel() for value in judge.state_dict().values()) * 2 < 2_000_000
