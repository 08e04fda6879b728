"""The training loop: it trains, stops, and resumes where it stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, load_tokenizer
from motiongen_ardy.checkpoint.stats import load_stats
from motiongen_ardy.model.config import TokenizerConfig, TransformerConfig
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.train.denoiser import denoiser_of, train_denoiser
from motiongen_ardy.train.denoiser_loss import DenoiserLoss
from motiongen_ardy.train.feature_bank import build_feature_bank, natural_layout
from motiongen_ardy.train.loop import UNFINISHED
from motiongen_ardy.train.loop_settings import LoopSettings
from motiongen_ardy.train.recipe import MINI_DENOISER
from motiongen_ardy.train.run_folder import STATE_FILE, ResumeError
from motiongen_ardy.train.tokenizer import TokenizerTask, train_tokenizer
from motiongen_ardy.train.windows import OwnHistory, WindowSampler
from motiongen_server.runner.facts import model_facts
from tests.ardy.train.clips import swinging_dataset

SMALL = TransformerConfig(width=16, feed_forward=32, num_layers=1, num_heads=2)
TOKENIZER = TokenizerConfig(transformer=SMALL, latent_dim=8, levels=(16,) * 8)


@pytest.fixture
def settings(tmp_path: Path) -> LoopSettings:
    return LoopSettings(out=tmp_path / "run", steps=6, learning_rate=1e-3, warmup_steps=2, log_every=2, bfloat16=False)


def test_training_resumes_from_the_saved_step_and_exports_a_working_model(settings: LoopSettings) -> None:
    dataset = swinging_dataset()
    first = train_tokenizer(TOKENIZER, dataset, replace(settings, steps=4), batch=2)
    assert first.step == 4
    weights = first.task.module.state_dict()["tokenizer.encoder.input_proj.weight"].clone()
    second = train_tokenizer(TOKENIZER, dataset, settings, batch=2)
    assert second.step == 6
    moved = second.task.module.state_dict()["tokenizer.encoder.input_proj.weight"] - weights
    assert 0 < float(moved.abs().max()) < 0.02  # two more small steps, not a fresh start
    tokenizer = load_tokenizer(settings.out)
    model = denoiser_of(tokenizer, replace(MINI_DENOISER, transformer=SMALL, latent_dim=8, text_dim=8), horizon=16)
    denoising = replace(settings, out=settings.out / "denoiser")
    trainer = train_denoiser(model, dataset, "hashed", denoising, batch=4)
    assert trainer.step == 6
    trained = load_checkpoint(denoising.out)
    request = RolloutRequest(num_frames=32, text=torch.zeros(8), num_steps=2, weights=GuidanceWeights(1.0, 1.0))
    assert bool(rollout(trained, request).isfinite().all())


def test_a_finished_run_is_not_trained_further(settings: LoopSettings) -> None:
    dataset = swinging_dataset()
    train_tokenizer(TOKENIZER, dataset, settings, batch=2)
    again = train_tokenizer(TOKENIZER, dataset, settings, batch=2)
    assert again.step == settings.steps
    assert again.exit_code == 0


def test_a_denoiser_does_not_resume_with_another_tokenizer(settings: LoopSettings) -> None:
    dataset = swinging_dataset()
    train_tokenizer(TOKENIZER, dataset, replace(settings, steps=2), batch=2)
    denoising = replace(settings, out=settings.out / "denoiser", steps=1)
    config = replace(MINI_DENOISER, transformer=SMALL, latent_dim=8, text_dim=8)

    def resume(steps: int) -> int:
        model = denoiser_of(load_tokenizer(settings.out), config, horizon=16)
        return train_denoiser(model, dataset, "hashed", replace(denoising, steps=steps), batch=2).step

    assert resume(1) == 1
    train_tokenizer(TOKENIZER, dataset, replace(settings, steps=2), batch=2)  # done already: its weights stay
    assert resume(2) == 2
    train_tokenizer(TOKENIZER, dataset, replace(settings, steps=8), batch=2)
    with pytest.raises(ResumeError, match="began with another tokenizer"):
        resume(3)
    state = torch.load(denoising.out / STATE_FILE, weights_only=True)
    del state["fingerprint"]
    torch.save(state, denoising.out / STATE_FILE)
    assert resume(3) == 3, "older states have no fingerprint"


def test_training_stops_at_its_time_limit_and_saves(settings: LoopSettings) -> None:
    trainer = train_tokenizer(TOKENIZER, swinging_dataset(), replace(settings, steps=10_000, minutes=0.01), batch=2)
    assert 0 < trainer.step < 10_000
    assert trainer.exit_code == UNFINISHED
    assert (settings.out / "state.pt").exists()
    assert load_tokenizer(settings.out).config == TOKENIZER


@pytest.mark.parametrize("num_base_steps", [1, 2, 3])
def test_a_model_with_few_base_steps_trains_on_its_own_history(settings: LoopSettings, num_base_steps: int) -> None:
    dataset = swinging_dataset()
    train_tokenizer(TOKENIZER, dataset, replace(settings, steps=1), batch=2)
    small = replace(MINI_DENOISER, transformer=SMALL, latent_dim=8, text_dim=8)
    model = denoiser_of(load_tokenizer(settings.out), small, 8, num_base_steps)
    layout = model.representation
    bank = build_feature_bank(dataset, natural_layout(dataset.skeleton, layout.fps))
    sampler = WindowSampler(bank, np.ones((len(bank.captions.texts), 8), np.float32), layout, 8, batch=4)
    batch = sampler.sample(OwnHistory(), torch.Generator().manual_seed(0))
    total, _ = DenoiserLoss(model)(batch)
    assert bool(total.isfinite())
    facts = model_facts(model, "few", 4)
    assert (facts.min_steps, facts.default_steps, facts.max_steps) == (
        min(2, num_base_steps), num_base_steps, num_base_steps,
    )  # fmt: skip


def test_a_run_killed_before_its_first_export_resumes(settings: LoopSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = swinging_dataset()

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(TokenizerTask, "export", killed)
        with pytest.raises(KeyboardInterrupt):
            train_tokenizer(TOKENIZER, dataset, replace(settings, steps=2), batch=2)
    began = load_stats(settings.out / "stats" / "motion", dataset.skeleton.feature_dim + 4)
    trainer = train_tokenizer(TOKENIZER, dataset, settings, batch=2)
    assert trainer.step == settings.steps
    assert torch.equal(load_tokenizer(settings.out).representation.stats.mean, began.mean)
    assert not list(settings.out.rglob("*.partial"))
