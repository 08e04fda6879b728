"""Checkpoint folders from the Hugging Face hub, through its own client: cached, resumable, pinned to a revision."""

from __future__ import annotations

import errno
from collections.abc import Sequence
from pathlib import Path

CHECKPOINT_FILES = (
    "config.yaml",
    "denoiser.safetensors",
    "tokenizer.safetensors",
    *(f"stats/{part}/{name}.npy" for part in ("motion", "post_quantization", "pre_quantization")
      for name in ("mean", "std")),
)  # fmt: skip
COMPANIONS = (
    "MODEL_CARD.md", "README.md", "LICENSE*",
    # How the weights are to be sampled (without these files, as the released ones), and what they were trained for.
    "sampling.yaml", "prompt_paces.safetensors", "capabilities.yaml", "prompt_domain.safetensors",
)  # fmt: skip
BY_HAND = "put the files into a folder and give that, or set CHECKPOINTS_DIR to the folder that holds it"
NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


class HubError(ValueError):
    """Raised for a repository that cannot be fetched; the message says why and what to do."""


def fetch_checkpoint(
    repo_id: str, revision: str | None = None, cache: Path | None = None, endpoint: str | None = None
) -> Path:
    """The folder of a repository's checkpoint, downloaded unless it is already in the cache.

    revision: commit, tag or branch; None: `main`. A commit that is in the cache needs no network; for a branch or tag,
    the cached state is used if the hub cannot be reached. cache: None: `$HF_HUB_CACHE`. Only the files of the released
    layout and those that may accompany them are fetched. Token, endpoint, proxy and offline mode are those of
    huggingface_hub: `HF_TOKEN`, `HF_ENDPOINT`, `HTTPS_PROXY`, `HF_HUB_OFFLINE`. Raises HubError.
    """
    folder = fetch_files(repo_id, (*CHECKPOINT_FILES, *COMPANIONS), revision, cache, endpoint)
    missing = [name for name in CHECKPOINT_FILES if not (folder / name).is_file()]
    if missing:
        raise HubError(
            f"{_called(repo_id, revision)} lacks {', '.join(missing)}; it is no checkpoint in the released layout"
        )
    return folder


def fetch_files(
    repo_id: str,
    patterns: Sequence[str],
    revision: str | None = None,
    cache: Path | None = None,
    endpoint: str | None = None,
    *,
    by_hand: str = BY_HAND,
) -> Path:
    """The folder with the files of a repository that match a pattern; otherwise as `fetch_checkpoint`.

    by_hand: what the error recommends if the hub cannot be reached, such as where to put the files.
    """
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import HTTPError

    try:
        return Path(
            snapshot_download(
                repo_id, revision=revision, cache_dir=cache, endpoint=endpoint, allow_patterns=list(patterns)
            )
        )
    except (HTTPError, OSError, ValueError) as error:
        raise HubError(_advice(repo_id, revision, by_hand, error)) from error


def _called(repo_id: str, revision: str | None) -> str:
    return f"the repository {repo_id}" + (f" at revision {revision}" if revision else "")


def _advice(repo_id: str, revision: str | None, by_hand: str, error: Exception) -> str:
    """What went wrong, and what to do about it. by_hand: how to go on without the hub."""
    from huggingface_hub import errors

    called = _called(repo_id, revision)
    if isinstance(error, errors.GatedRepoError):
        return (
            f"{called} is gated: accept its licence at https://huggingface.co/{repo_id}, then give an access token "
            "in HF_TOKEN or by `hf auth login`"
        )
    if isinstance(error, errors.RevisionNotFoundError):
        return f"{called} does not exist: the repository has no such commit, tag or branch"
    if isinstance(error, errors.RepositoryNotFoundError):
        return f"{called} does not exist, or is private and needs an access token in HF_TOKEN"
    if isinstance(error, errors.HFValidationError):
        return f"{repo_id!r} is no name of a repository: {error}"
    if isinstance(error, OSError) and error.errno in NO_ROOM:
        return (
            f"no room on the disk for {called}: free some, or set HF_HUB_CACHE to a folder that has it; "
            "what was fetched so far is kept, and the next start goes on from there"
        )
    if isinstance(error, PermissionError):
        return f"{called} cannot be kept: {error}; set HF_HUB_CACHE to a folder that can be written to"
    if isinstance(error, errors.IncompleteSnapshotError):
        return f"{called} is only in part in the cache, and the hub cannot be reached: connect once to fetch the rest"
    if isinstance(error, errors.LocalEntryNotFoundError):
        return (
            f"{called} is not in the cache, and the hub cannot be reached ({_cause(error)}): connect once, or {by_hand}"
        )
    return f"{called} cannot be fetched: {_cause(error)}; the next start goes on where this one stopped"


def _cause(error: Exception) -> str:
    """The first line of the innermost cause."""
    innermost = error.__cause__ if isinstance(error.__cause__, Exception) else error
    return (str(innermost).strip() or type(innermost).__name__).splitlines()[0][:300]
