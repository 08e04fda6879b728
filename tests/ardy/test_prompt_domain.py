"""The prompt domain: how well it judges prompts that were never captions, how it is made, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.data.captions import paraphrases
from motiongen_ardy.data.phrases import MANNERS
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.text.domain import (
    DOMAIN_FILE,
    FORMAT,
    DomainError,
    PromptDomain,
    best_threshold,
    make_domain,
    read_domain,
    write_domain,
)
from motiongen_ardy.text.encoder import TextEncoder
from motiongen_ardy.text.static import built_in_text_folder
from motiongen_ardy.train.prompt_domain import CONFIGS, MOST_KEPT, known_captions, main, read_prompts
from tests.ardy.safetensors_bytes import safetensors_of

PROMPTS = Path(__file__).resolve().parents[1] / "data" / "prompts"
SIDED = ("walk-{}", "walk-turn-{}", "wave-{}-hand", "raise-up-{}-hand", "lower-{}-hand", "hold-up-{}-hand")
KNOWN = (
    "walk", "walk-back", "run", "dash", "bow", "bye", "byebye", "guide", "stand", "wave-both-hands",
    "raise-up-both-hands", "lower-both-hands", "hold-up-both-hands", *(slug.format("left") for slug in SIDED),
    *(slug.format("right") for slug in SIDED),
)  # fmt: skip

UNLEARNED = {"a man bows", "a person takes a deep bow"}


@pytest.fixture(scope="module")
def encoder() -> TextEncoder:
    return load_text_encoder("static")


@pytest.fixture(scope="module")
def domain(encoder: TextEncoder) -> PromptDomain:
    """The domain of the captions made from the labels of the built-in model's training set."""
    captions = sorted({text for label in KNOWN for style in MANNERS for text in paraphrases(label, style)})
    made = make_domain(encoder.identity, encoder.encode(captions), MOST_KEPT)
    lists = (read_prompts(CONFIGS / f"prompts-{name}.txt") for name in ("inside", "outside"))
    threshold, _, _ = best_threshold(*(made.distances(encoder.encode(texts)) for texts in lists))
    return replace(made, threshold=threshold)


def misjudged(encoder: TextEncoder, domain: PromptDomain) -> tuple[list[str], list[str]]:
    """Prompts inside taken for outside, and outside taken for inside, from lists that set no threshold."""
    wrong = []
    for name, is_outside in (("inside", False), ("outside", True)):
        texts = read_prompts(PROMPTS / f"{name}.txt")
        far = domain.distances(encoder.encode(texts)) > domain.threshold
        wrong.append([text for text, each in zip(texts, far, strict=True) if bool(each) is not is_outside])
    return wrong[0], wrong[1]


def test_a_domain_of_captions_judges_prompts_it_was_not_tuned_on(encoder: TextEncoder, domain: PromptDomain) -> None:
    alarms, misses = misjudged(encoder, domain)
    assert len(alarms) <= 2, alarms
    assert len(misses) <= 3, misses
    assert not {"jump", "a person jumps", "a person sits down", "a person dances"} & set(misses)


def test_the_domain_of_the_built_in_model_misjudges_few_prompts(encoder: TextEncoder) -> None:
    paths = list(built_in_text_folder().parent.glob(f"*/{DOMAIN_FILE}"))
    assert paths
    for path in paths:
        alarms, misses = misjudged(encoder, read_domain(path))
        assert set(alarms) >= UNLEARNED, "the built-in model does not bow: that must be outside its domain"
        assert len(set(alarms) - UNLEARNED) <= 2, (path, alarms)
        assert len(misses) <= 2, (path, misses)


def test_prompts_of_the_test_and_of_the_threshold_do_not_overlap() -> None:
    for name, count in (("inside", 44), ("outside", 60)):
        assert len(read_prompts(PROMPTS / f"{name}.txt")) == count
        assert not set(read_prompts(PROMPTS / f"{name}.txt")) & set(read_prompts(CONFIGS / f"prompts-{name}.txt"))


def test_a_domain_file_round_trips_and_is_small(tmp_path: Path, domain: PromptDomain) -> None:
    write_domain(tmp_path / DOMAIN_FILE, domain)
    assert (tmp_path / DOMAIN_FILE).stat().st_size <= 300_000
    read = read_domain(tmp_path / DOMAIN_FILE)
    assert (read.text_encoder, read.threshold) == (domain.text_encoder, domain.threshold)
    np.testing.assert_array_equal(read.mean, domain.mean)
    np.testing.assert_allclose(read.directions, domain.directions, atol=1e-6)


def test_keeping_more_captions_reduces_the_largest_distance() -> None:
    captions = np.random.default_rng(1).standard_normal((400, 8)).astype(np.float32)
    radii = [float(make_domain("e", captions, count).distances(captions).max()) for count in (4, 40, 400)]
    assert radii[0] > radii[1] > radii[2]
    assert radii[2] == pytest.approx(0.0, abs=1e-3)


def test_duplicate_captions_are_kept_once() -> None:
    captions = np.eye(3, dtype=np.float32)[[0, 0, 1, 2, 2]]
    assert len(make_domain("e", captions, 5).directions) == 3


@pytest.mark.parametrize(
    ("inside", "outside", "wrong"), [([0.1, 0.2], [0.8, 0.9], (0, 0)), ([0.1, 0.2, 0.85], [0.8, 0.9], (1, 0))]
)
def test_the_best_threshold_separates_as_many_prompts_as_possible(
    inside: Sequence[float], outside: Sequence[float], wrong: tuple[int, int]
) -> None:
    threshold, alarms, misses = best_threshold(np.array(inside, np.float32), np.array(outside, np.float32))
    assert 0.2 < threshold < 0.8
    assert (alarms, misses) == wrong


def test_a_domain_or_threshold_without_prompts_is_refused() -> None:
    with pytest.raises(DomainError, match="0 captions"):
        make_domain("e", np.zeros((0, 3), np.float32), 5)
    with pytest.raises(DomainError, match="inside and prompts outside"):
        best_threshold(np.zeros(0, np.float32), np.ones(2, np.float32))


def test_invalid_domain_files_are_refused(tmp_path: Path) -> None:
    from safetensors.numpy import save_file

    path = tmp_path / DOMAIN_FILE
    with pytest.raises(DomainError, match="no file"):
        read_domain(path)
    save_file({"vectors": np.zeros((2, 2), np.float32)}, path, {"format": "motiongen-prompts-1"})
    with pytest.raises(DomainError, match="no prompt domain"):
        read_domain(path)
    sound = {"mean": np.zeros(2, np.float32), "directions": np.ones((3, 2), np.int8)}
    notes = {"format": "motiongen-prompt-domain-1", "text_encoder": "e", "threshold": "0.5"}
    for tensors, metadata in (
        ({**sound, "mean": np.zeros(3, np.float32)}, notes),
        ({**sound, "mean": np.full(2, np.nan, np.float32)}, notes),
        ({**sound, "directions": np.ones((3, 2), np.float32)}, notes),
        ({**sound, "directions": np.ones((0, 2), np.int8)}, notes),
        (sound, {**notes, "threshold": "nan"}),
        (sound, {**notes, "threshold": "far"}),
    ):
        save_file(tensors, path, metadata)
        with pytest.raises(DomainError):
            read_domain(path)


@dataclass(frozen=True)
class _Part:
    content: str
    captions: tuple[str, ...]
    segments: tuple[_Part, ...] = ()
    derived_from: str = ""


@pytest.mark.parametrize(("mean", "directions"), [("BF16", "I8"), ("F32", "F8_E4M3"), ("F32", "U8"), ("F64", "I8")])
def test_tensors_of_another_type_are_refused_by_its_name(tmp_path: Path, mean: str, directions: str) -> None:
    path = tmp_path / "domain.safetensors"
    size = {"BF16": 2, "F32": 4, "F64": 8}[mean]
    tensors = {"mean": (mean, [3], bytes(3 * size)), "directions": (directions, [1, 3], b"\1\1\1")}
    path.write_bytes(safetensors_of(tensors, {"format": FORMAT, "text_encoder": "e", "threshold": "1"}))
    with pytest.raises(DomainError, match=f"of the types {mean} and {directions}; they must be F32 and I8"):
        read_domain(path)


def test_labels_with_few_clips_do_not_count() -> None:
    walks = [_Part("walk", ("walk", f"walk {number}"), (_Part("stop", ("stop",)),)) for number in range(3)]
    clips = [*walks, _Part("jump", ("jump",))]
    assert known_captions(clips, 3) == ["stop", "walk", "walk 0", "walk 1", "walk 2"]  # type: ignore[arg-type]
    assert "jump" in known_captions(clips, 1)  # type: ignore[arg-type]


def test_excluded_labels_do_not_count_however_many_clips_they_have() -> None:
    clips = [_Part("walk", ("walk",)), *(_Part("bow", (f"bow {k}",)) for k in range(5))]
    assert known_captions(clips, 1, ["bow"]) == ["walk"]  # type: ignore[arg-type]


def test_captions_of_derived_clips_do_not_count() -> None:
    clips = [_Part("walk", ("walk",)), _Part("walk", ("walk and then stop",), derived_from="one")]
    assert known_captions(clips, 1) == ["walk"]  # type: ignore[arg-type]


def test_the_command_refuses_a_folder_without_a_training_set(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path), str(tmp_path / "out")]) == 2
    assert "error:" in capsys.readouterr().err
