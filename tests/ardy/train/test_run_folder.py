"""Run folders: one training holds one at a time, invalid states are reported, and valid ones never overwritten."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.model.config import TokenizerConfig, TransformerConfig
from motiongen_ardy.train import run_folder, tokenizer
from motiongen_ardy.train.denoiser import denoiser_of, train_denoiser
from motiongen_ardy.train.loop import UNFINISHED, Diverged, Trainer
from motiongen_ardy.train.loop_settings import LoopSettings
from motiongen_ardy.train.recipe import MINI_DENOISER
from motiongen_ardy.train.run_folder import STATE_FILE, ResumeError, RunFolderError, held
from motiongen_ardy.train.tokenizer import TokenizerTask, train_tokenizer
from tests.ardy.train.clips import swinging_clip, swinging_dataset

SMALL = TransformerConfig(width=16, feed_forward=32, num_layers=1, num_heads=2)
TOKENIZER = TokenizerConfig(transformer=SMALL, latent_dim=8, levels=(16,) * 8)


@pytest.fixture
def settings(tmp_path: Path) -> LoopSettings:
    return LoopSettings(out=tmp_path / "run", steps=2, learning_rate=1e-3, warmup_steps=1, bfloat16=False)


def train(settings: LoopSettings, config: TokenizerConfig = TOKENIZER, fps: float = 20.0) -> Trainer:
    return train_tokenizer(config, replace(swinging_dataset(), fps=fps), settings, batch=1)


def test_a_second_training_in_a_run_folder_is_refused_until_the_first_ends(settings: LoopSettings) -> None:
    with held(settings.out):
        with pytest.raises(RunFolderError, match="another training writes there; wait for its end or stop it"):
            train(settings)
        with held(settings.out, rank=1):
            pass
    assert train(settings).step == 2


def test_the_training_of_a_denoiser_holds_its_folder_too(settings: LoopSettings) -> None:
    model = denoiser_of(
        train(settings).task.module.tokenizer,  # type: ignore[union-attr]
        replace(MINI_DENOISER, transformer=SMALL, latent_dim=8, text_dim=8),
        horizon=16,
    )
    with held(settings.out / "denoiser"), pytest.raises(RunFolderError, match="another training writes there"):
        train_denoiser(model, swinging_dataset(), "hashed", replace(settings, out=settings.out / "denoiser"), batch=1)


@pytest.mark.parametrize("kept", [0, 2, 1000, -3000, -1])
def test_a_truncated_state_is_reported(kept: int, settings: LoopSettings) -> None:
    train(settings)
    path = settings.out / STATE_FILE
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(ResumeError, match=r"state\.pt cannot be read: .*give another run folder, or delete it"):
        train(settings)


def test_a_file_that_is_not_a_training_state_is_reported(settings: LoopSettings) -> None:
    train(settings)
    torch.save({"weights": torch.zeros(1)}, settings.out / STATE_FILE)
    with pytest.raises(ResumeError, match="is no state of a training"):
        train(settings)


def test_a_state_of_other_sizes_is_reported(settings: LoopSettings) -> None:
    train(settings)
    other = replace(TOKENIZER, transformer=replace(SMALL, feed_forward=64))
    with pytest.raises(ResumeError, match=r"does not fit what is to be trained: .* give the recipe that it began with"):
        train(replace(settings, steps=3), other)
    assert train(replace(settings, steps=3)).step == 3


def test_a_tokenizer_does_not_resume_at_another_frame_rate(settings: LoopSettings) -> None:
    train(settings)
    with pytest.raises(ResumeError, match="began with frames a second 20, not 30"):
        train(replace(settings, steps=3), fps=30.0)
    state = torch.load(settings.out / STATE_FILE, weights_only=True)
    del state["terms"]
    torch.save(state, settings.out / STATE_FILE)
    assert train(replace(settings, steps=3)).step == 3, "older states have no terms"


def test_a_denoiser_does_not_resume_with_another_text_encoder(
    settings: LoopSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    codec = train(settings).task.module.tokenizer  # type: ignore[union-attr]
    denoising = replace(settings, out=settings.out / "denoiser")
    config = replace(MINI_DENOISER, transformer=SMALL, latent_dim=8, text_dim=8)

    def resume(steps: int) -> int:
        model = denoiser_of(codec, config, horizon=16)
        return train_denoiser(model, swinging_dataset(), "hashed", replace(denoising, steps=steps), batch=1).step

    assert resume(1) == 1
    with monkeypatch.context() as patched:
        patched.setattr("motiongen_ardy.text.hashed.HashedTextEncoder.identity", "another-8")
        with pytest.raises(ResumeError, match="began with text encoder hashed-8, not another-8"):
            resume(2)
    assert resume(2) == 2


def test_a_run_stopped_before_its_first_update_resumes(settings: LoopSettings, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(Trainer, "train_step", lambda _: pytest.fail("no step is trained yet"))
        train(replace(settings, steps=0))
    assert train(settings).step == 2


def test_diverged_weights_do_not_replace_the_saved_ones(settings: LoopSettings) -> None:
    train(settings)
    with pytest.raises(Diverged, match=r"not finite.* go on from there with a lower --lr than 1e\+38"):
        train(replace(settings, steps=6, learning_rate=1e38))
    assert torch.load(settings.out / STATE_FILE, weights_only=True)["step"] == 2
    assert train(replace(settings, steps=8)).exit_code == 0


@pytest.mark.parametrize("save_minutes", [1e-9, 60.0])
def test_nothing_is_saved_if_losses_or_weights_are_not_finite(
    save_minutes: float, settings: LoopSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = train(replace(settings, steps=1))
    trainer.check_sound({"total": torch.tensor(1.0)})

    def diverging(self: Trainer) -> dict[str, Tensor]:
        self.step += 1
        return {"total": torch.tensor(torch.nan)}

    monkeypatch.setattr(Trainer, "train_step", diverging)
    monkeypatch.setattr(Trainer, "save", lambda _: pytest.fail("the valid state is overwritten"))
    with pytest.raises(Diverged, match=r"these are not finite: \{'total': nan\}"):
        train(replace(settings, steps=2, save_minutes=save_minutes))
    with torch.no_grad():
        next(trainer.task.module.parameters()).fill_(torch.nan)
    with pytest.raises(Diverged, match="weights are not finite"):
        trainer.check_sound({"total": torch.tensor(1.0)})


def test_a_full_disk_ends_a_training_with_a_message_and_keeps_the_state(
    settings: LoopSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    train(settings)
    before = (settings.out / STATE_FILE).read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(run_folder.torch, "save", full)
        with pytest.raises(RunFolderError, match="No space left on device; what was saved before is kept"):
            train(replace(settings, steps=3))
    assert (settings.out / STATE_FILE).read_bytes() == before
    assert not list(settings.out.rglob("*.partial"))


def test_a_folder_that_cannot_be_created_is_reported(settings: LoopSettings) -> None:
    settings.out.touch()
    with pytest.raises(RunFolderError, match="run cannot be written"):
        train(settings)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_training_after_a_whole_step_which_is_saved(
    number: signal.Signals, settings: LoopSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An update that is interrupted would be saved half done."""
    draw: Callable[..., tuple[Tensor, Tensor]] = TokenizerTask.sample
    updated: list[int] = []

    def interrupted(self: TokenizerTask, *given: object) -> tuple[Tensor, Tensor]:
        if updated[-1] == 3 and len(updated) == 3:
            updated.append(0)
            signal.raise_signal(number)
        return draw(self, *given)

    update = Trainer._update

    def counted(self: Trainer, *given: object) -> dict[str, Tensor]:
        updated.append(self.step + 1)
        return update(self, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(TokenizerTask, "sample", interrupted)
    monkeypatch.setattr(Trainer, "_update", counted)
    handlers = [signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT)]
    trainer = train(replace(settings, steps=9))
    assert (trainer.step, trainer.exit_code) == (3, UNFINISHED)
    assert torch.load(settings.out / STATE_FILE, weights_only=True)["step"] == 3
    assert [signal.getsignal(one) for one in (signal.SIGTERM, signal.SIGINT)] == handlers


def test_a_second_ctrl_c_ends_a_single_process_but_none_of_several(monkeypatch: pytest.MonkeyPatch) -> None:
    """torchrun forwards its signal to processes that already got one from the terminal."""
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    heard: list[object] = []
    with monkeypatch.context() as patched:
        patched.setattr(signal, "signal", lambda *given: heard.append(given))
        trainer = Trainer.__new__(Trainer)
        trainer._ask_to_stop(signal.SIGINT, None)
        assert trainer.stopping
        assert not heard
        patched.setattr(torch.distributed, "is_initialized", lambda: False)
        trainer._ask_to_stop(signal.SIGINT, None)
        assert heard == [(signal.SIGINT, signal.default_int_handler)]


def test_clips_that_are_all_too_short_are_refused(
    settings: LoopSettings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clips = tuple(swinging_clip(number, 15) for number in range(3))
    MotionDataset(swinging_dataset().skeleton, 20.0, clips).save(tmp_path / "data")
    assert tokenizer.main([str(tmp_path / "data"), str(settings.out), "--steps", "1", "--device", "cpu"]) == 2
    assert "error: none of the 3 clips to train on has 16 frames" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--steps", "0", "'0' is not a whole number of 1 or more"),
        ("--batch", "-2", "'-2' is not a whole number of 1 or more"),
        ("--seed", "x", "'x' is not a whole number of 0 or more"),
        ("--lr", "nan", "'nan' is no finite number"),
        ("--lr", "0", "'0' is not above 0"),
        ("--minutes", "-1", "'-1' is below 0"),
        ("--device", "banana", "'banana' is no device for training; give cpu or cuda"),
        ("--device", "cuda:7", "'cuda:7': there are 1 GPUs that torch can use, and this would need 8"),
    ],
)
def test_options_out_of_range_are_refused(
    option: str, value: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(SystemExit) as ended:
        tokenizer.main(["data", "out", f"{option}={value}"])
    assert ended.value.code == 2
    assert f"argument {option}: {said}" in capsys.readouterr().err


def test_more_processes_than_gpus_are_refused_before_any_joins(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv("LOCAL_RANK", "2")
    with pytest.raises(SystemExit):
        tokenizer.main(["data", "out", "--device", "cuda"])
    assert "there are 2 GPUs that torch can use, and this would need 3" in capsys.readouterr().err
