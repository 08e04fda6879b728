"""Checkpoints from a hub: fetched by huggingface_hub's own client from a server in this process."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import huggingface_hub
import pytest
from huggingface_hub import constants
from huggingface_hub.utils import disable_progress_bars

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, save_checkpoint
from motiongen_ardy.checkpoint.hub import CHECKPOINT_FILES, HubError, fetch_checkpoint
from motiongen_ardy.checkpoint.model_card import read_model_card
from tests.ardy.checkpoint.test_paces_file import paces
from tests.ardy.conftest import GOLDEN
from tests.ardy.fake_hub import COMMIT, FakeHub, files_of, serving

REPOSITORY = "somebody/tiny-walker"
TINY = GOLDEN / "tiny-core27" / "checkpoint"


@pytest.fixture(autouse=True)
def no_token_and_no_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_DISABLE_IMPLICIT_TOKEN", "1")
    disable_progress_bars()


@pytest.fixture
def hub() -> Iterator[FakeHub]:
    files = files_of(TINY) | {
        "README.md": b"---\nlicense: other\nlicense_name: walker-licence\n---\n",
        "video.mp4": b"0",
    }
    with serving(FakeHub(REPOSITORY, files)) as served:
        yield served


def fetch(hub: FakeHub, cache: Path, revision: str | None = None) -> Path:
    return fetch_checkpoint(REPOSITORY, revision, cache=cache, endpoint=hub.endpoint)


def test_a_fetched_repository_loads_as_a_checkpoint(hub: FakeHub, tmp_path: Path) -> None:
    hub.files |= files_of(TINY)
    folder = fetch(hub, tmp_path)
    assert load_checkpoint(folder).config == load_checkpoint(TINY).config
    card = read_model_card(folder)
    assert (card.model_id, card.licence) == ("tiny-walker", "walker-licence")


def test_only_the_checkpoint_and_its_card_are_fetched(hub: FakeHub, tmp_path: Path) -> None:
    fetch(hub, tmp_path)
    assert sorted(hub.downloads()) == sorted([*CHECKPOINT_FILES, "README.md"])


def test_sampling_options_and_paces_are_fetched_with_the_checkpoint(hub: FakeHub, tmp_path: Path) -> None:
    ours = load_checkpoint(TINY)
    ours.sampling = replace(ours.sampling, project_root=True, fit_prompts=True)
    ours.paces = paces()
    save_checkpoint(ours, tmp_path / "ours")
    hub.files |= files_of(tmp_path / "ours")
    fetched = load_checkpoint(fetch(hub, tmp_path / "cache"))
    assert fetched.sampling == ours.sampling
    assert fetched.paces is not None


def test_cached_files_are_not_fetched_again(hub: FakeHub, tmp_path: Path) -> None:
    fetch(hub, tmp_path)
    hub.requests.clear()
    fetch(hub, tmp_path)
    assert hub.downloads() == []


def test_an_interrupted_download_resumes_where_it_stopped(
    hub: FakeHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(constants, "DOWNLOAD_CHUNK_SIZE", 1000)  # an interrupted download is kept in whole chunks
    hub.cut = name = "denoiser.safetensors"
    hub.files[name] = bytes(range(200)) * 50
    folder = fetch(hub, tmp_path)
    asked = [start for _, path, start in hub.requests if path.endswith(name) and start]
    assert asked == ["bytes=5000-"]
    assert (folder / name).read_bytes() == hub.files[name]


def test_a_cached_commit_is_found_without_a_request(hub: FakeHub, tmp_path: Path) -> None:
    online = fetch(hub, tmp_path, COMMIT)
    hub.requests.clear()
    assert fetch(hub, tmp_path, COMMIT) == online
    assert hub.requests == []


@pytest.mark.parametrize("revision", [None, "v1", COMMIT])
def test_the_cache_is_used_while_the_hub_is_unreachable(tmp_path: Path, revision: str | None) -> None:
    with serving(FakeHub(REPOSITORY, dict.fromkeys(CHECKPOINT_FILES, b""))) as hub:
        online = fetch(hub, tmp_path, revision)
    assert fetch(hub, tmp_path, revision) == online


def test_an_unreachable_hub_with_an_empty_cache_is_reported_with_advice(tmp_path: Path) -> None:
    with serving(FakeHub(REPOSITORY, {})) as hub:
        pass
    with pytest.raises(HubError, match=r"not in the cache.*cannot be reached.*CHECKPOINTS_DIR"):
        fetch(hub, tmp_path)


def test_offline_mode_is_honoured(hub: FakeHub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(HubError, match="not in the cache"):
        fetch(hub, tmp_path)
    assert hub.requests == []


@pytest.mark.parametrize(
    ("refusal", "words"),
    [
        ((403, "GatedRepo"), "is gated: accept its licence at https://huggingface.co/somebody/tiny-walker.*HF_TOKEN"),
        ((401, "RepoNotFound"), "does not exist, or is private"),
        ((404, "RepoNotFound"), "does not exist, or is private"),
    ],
)
def test_a_refusal_by_the_hub_is_reported_with_advice(
    hub: FakeHub, tmp_path: Path, refusal: tuple[int, str], words: str
) -> None:
    hub.refusal = refusal
    with pytest.raises(HubError, match=words):
        fetch(hub, tmp_path)


def test_an_unknown_revision_is_named_in_the_error(hub: FakeHub, tmp_path: Path) -> None:
    with pytest.raises(HubError, match="at revision v9 does not exist"):
        fetch(hub, tmp_path, "v9")


def test_a_repository_without_a_checkpoint_is_refused(hub: FakeHub, tmp_path: Path) -> None:
    del hub.files["tokenizer.safetensors"]
    with pytest.raises(HubError, match=r"lacks tokenizer\.safetensors"):
        fetch(hub, tmp_path)


def test_a_full_disk_is_reported_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", full)
    with pytest.raises(HubError, match=r"no room on the disk.*HF_HUB_CACHE"):
        fetch_checkpoint(REPOSITORY, cache=tmp_path)


def test_an_invalid_repository_name_is_refused_without_a_request(hub: FakeHub, tmp_path: Path) -> None:
    with pytest.raises(HubError, match="no name of a repository"):
        fetch_checkpoint("a/b/../c", cache=tmp_path, endpoint=hub.endpoint)
    assert hub.requests == []
