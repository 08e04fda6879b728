"""Broken checkpoint folders: `load_checkpoint` loads them or raises CheckpointError, and nothing else."""

from __future__ import annotations

import json
import os
import pickle
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motiongen_ardy.checkpoint.checkpoint import CheckpointError, load_checkpoint
from motiongen_ardy.checkpoint.npy import NpyError, read_npy
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.model.sampling.options import SamplingOptions
from tests.ardy.broken_checkpoints import (
    BROKEN_FOLDERS,
    FILES,
    broken_bytes,
    loads_or_refuses,
    write_folder,
)

FUZZ = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
MEAN = "stats/motion/mean.npy"


@FUZZ
@given(changes=BROKEN_FOLDERS)
def test_a_broken_folder_is_refused_or_loads(changes: dict[str, bytes | None]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        loads_or_refuses(lambda: load_checkpoint(write_folder(Path(folder), changes)), CheckpointError)


@FUZZ
@given(
    content=st.one_of(broken_bytes(FILES[MEAN]), st.binary(max_size=200).map(lambda tail: b"\x93NUMPY\x01\0" + tail))
)
def test_a_broken_array_is_refused_or_read(content: bytes) -> None:
    loads_or_refuses(lambda: read_npy(content), NpyError)


def refusal(folder: Path, changes: dict[str, bytes | None]) -> str:
    with pytest.raises(CheckpointError) as caught:
        load_checkpoint(write_folder(folder, changes))
    return str(caught.value)


def with_config(change: Any) -> bytes:
    config = yaml.safe_load(FILES["config.yaml"])
    change(config)
    return yaml.safe_dump(config).encode()


@pytest.mark.parametrize(
    "path",
    ["../secret", "/etc/passwd", "${checkpoint_dir}/../secret", "~/secret", "a\\..\\b", "${oc.env:HOME}/x", "a:b"],
)
@pytest.mark.parametrize("key", ["ckpt_path", "stats_path"])
def test_a_path_that_leaves_the_folder_is_refused(tmp_path: Path, path: str, key: str) -> None:
    def change(config: Any) -> None:
        (config["denoiser"] if key == "ckpt_path" else config["denoiser"]["motion_rep"])[key] = path

    assert f"{key} is" in refusal(tmp_path, {"config.yaml": with_config(change)})


@pytest.mark.parametrize("name", ["denoiser.safetensors", MEAN, "config.yaml"])
def test_a_symlink_to_a_file_outside_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    folder = write_folder(tmp_path / "model", {name: None})
    outside = tmp_path / "outside"
    outside.write_bytes(FILES[name])
    (folder / name).symlink_to(outside)
    with pytest.raises(CheckpointError, match="link out of the checkpoint folder"):
        load_checkpoint(folder)


def test_a_named_pipe_is_refused_without_blocking(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, {MEAN: None})
    os.mkfifo(folder / MEAN)
    with pytest.raises(CheckpointError, match="not a regular file"):
        load_checkpoint(folder)


def test_a_directory_in_place_of_a_weights_file_is_refused(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, {"denoiser.safetensors": None})
    (folder / "denoiser.safetensors").mkdir()
    with pytest.raises(CheckpointError, match="not a regular file"):
        load_checkpoint(folder)


def test_yaml_aliases_that_expand_exponentially_are_refused(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]" for level in range(1, 12)]
    assert "too large when its anchors are followed" in refusal(tmp_path, {"config.yaml": "\n".join(lines).encode()})


def test_yaml_aliases_that_expand_within_a_key_are_refused(tmp_path: Path) -> None:
    lines = ["? &a0 [x, x, x, x, x, x, x, x, x, x]", ": 1"]
    for level in range(1, 5):  # expanded, this many would take a second; a few more would take all memory
        lines += [f"? &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]", ": 1"]
    assert "a list or a mapping as a key" in refusal(tmp_path, {"config.yaml": "\n".join(lines).encode()})


def test_yaml_aliases_that_repeat_a_long_text_are_refused(tmp_path: Path) -> None:
    text = f"a: &a {'x' * 30_000}\nb: [{', '.join(['*a'] * 9)}]"
    assert "too large when its anchors are followed" in refusal(tmp_path, {"config.yaml": text.encode()})


HUGE = "0x" + "f" * 5000  # Python refuses to convert an integer with so many digits to text


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("config.yaml", f"gen_horizon_len: {HUGE}", "whole number of 5002 characters"),
        ("config.yaml", 'cfg_type: "\\ud800"', "half of a surrogate pair"),
        ("config.yaml", '"\\udfff": 1', "half of a surrogate pair"),
        ("sampling.yaml", f"approach_frames: {'9' * 400}", "whole number of 400 characters"),
    ],
)
def test_yaml_values_that_cannot_be_printed_or_sent_are_refused(
    tmp_path: Path, name: str, text: str, said: str
) -> None:
    assert said in refusal(tmp_path, {name: text.encode()})


def test_an_integer_too_large_for_a_float_is_out_of_range() -> None:
    with pytest.raises(ConfigError, match="from 0 to 100"):
        SamplingOptions(approach_frames=10**400)


def test_tensor_names_with_lone_surrogates_are_reported_escaped(tmp_path: Path) -> None:
    content = FILES["denoiser.safetensors"]
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    header["denoiser.\ud800\nsurplus"] = {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]}
    written = json.dumps(header).encode()
    text = refusal(
        tmp_path, {"denoiser.safetensors": len(written).to_bytes(8, "little") + written + content[8 + length :]}
    )
    assert r"extra '\ud800\nsurplus'" in text
    assert text.encode().isascii()


@pytest.mark.parametrize(
    "text", ["a: &a [*a]", "[" * 5000, "{a: " * 2000, "? " * 3000, "? [x]\n: y", "a: 1\na: 2", "", "-"]
)
def test_yaml_that_is_not_a_configuration_is_refused(tmp_path: Path, text: str) -> None:
    assert "config.yaml" in refusal(tmp_path, {"config.yaml": text.encode()})


class Trap:
    """An object that touches the marker file when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.marker,))


def test_pickles_are_never_opened(tmp_path: Path) -> None:
    marker = tmp_path / "ran"
    np.save(tmp_path / "object.npy", np.array([Trap(marker)], dtype=object), allow_pickle=True)
    contents = [pickle.dumps(Trap(marker)), (tmp_path / "object.npy").read_bytes()]
    for index, content in enumerate(contents):
        assert "not a readable .npy vector" in refusal(tmp_path / str(index), {MEAN: content})
        assert "not a safetensors file" in refusal(tmp_path / f"t{index}", {"tokenizer.safetensors": content})
    assert not marker.exists()


def test_invalid_statistics_are_all_listed(tmp_path: Path) -> None:
    for name, values in (("mean", np.full(334, np.nan)), ("std", np.zeros(334))):
        np.save(tmp_path / f"{name}.npy", values)
    changes: dict[str, bytes | None] = {
        f"stats/motion/{name}.npy": (tmp_path / f"{name}.npy").read_bytes() for name in ("mean", "std")
    }
    changes["stats/post_quantization/std.npy"] = None
    text = refusal(tmp_path / "model", changes)
    assert "mean.npy holds NaN" in text
    assert "std.npy holds nothing but zeros" in text
    assert "post_quantization/std.npy is missing" in text


@pytest.mark.parametrize("part", ["motion", "pre_quantization"])
def test_a_std_whose_square_overflows_float32_is_refused(tmp_path: Path, part: str) -> None:
    name = f"stats/{part}/std.npy"
    (tmp_path / "std.npy").write_bytes(FILES[name])
    deviations = np.load(tmp_path / "std.npy")
    deviations[7] = 1e20
    np.save(tmp_path / "std.npy", deviations)
    text = refusal(tmp_path / "model", {name: (tmp_path / "std.npy").read_bytes()})
    assert f"stats/{part}: a std is 1e+20, whose square no float32 holds" in text


def test_all_errors_of_a_config_are_listed_at_once(tmp_path: Path) -> None:
    def change(config: Any) -> None:
        config["denoiser"].update(num_layers=0, surprise=1)
        config["autoencoder"]["motion_rep"]["skeleton"]["_target_"] = "os.system"

    text = refusal(tmp_path, {"config.yaml": with_config(change)})
    for words in ("num_layers is 0", "unknown keys surprise", "'os.system'"):
        assert words in text
