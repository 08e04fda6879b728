"""The folder of a training: holds the state from which a run resumes, and is locked by one run at a time."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pickle
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError

from motiongen_ardy.core.files import written_whole

STATE_FILE = "state.pt"
_PARTS = ("module", "averaged", "optimizer", "step")
_ANEW = "give another run folder, or delete it to begin anew"


class ResumeError(ValueError):
    """Raised for a run folder whose training cannot be resumed with what is given; the message says what to do."""


class RunFolderError(ValueError):
    """Raised for a run folder that another training holds, or that cannot be written; the message says what to do."""


@contextlib.contextmanager
def held(folder: Path, rank: int = 0) -> Iterator[None]:
    """Lock a run folder, which is created if necessary, against other trainings, which would overwrite its saves.

    Of processes that train together, the first one locks it for all. The lock ends with its process, even if that is
    killed. Raises RunFolderError if another training holds the folder, or if it cannot be created.
    """
    if rank:
        yield
        return
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RunFolderError(
                f"{folder}: another training writes there; wait for its end or stop it, or give another run folder"
            ) from None
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Context for writing to a run folder: errors such as a full disk become RunFolderError."""
    try:
        yield
    except (OSError, SafetensorError) as error:
        raise RunFolderError(
            f"{folder} cannot be written: {error}; what was saved before is kept: make room there, or fix the"
            " problem, and give the same command again"
        ) from error


def write_state(folder: Path, state: Mapping[str, Any]) -> None:
    """Write the state to resume from, completely or not at all. Raises OSError."""
    with written_whole(folder / STATE_FILE) as partial, partial.open("wb") as file:
        torch.save(dict(state), file)


def read_state(folder: Path) -> dict[str, Any] | None:
    """The state that a run left; None if there is none. Raises ResumeError for a file that is not a state."""
    path = folder / STATE_FILE
    if not path.exists():
        return None
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, EOFError, RuntimeError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise ResumeError(f"{path} cannot be read: {_first_line(error)}; {_ANEW}") from error
    if not isinstance(state, dict) or not set(_PARTS) <= state.keys():
        raise ResumeError(f"{path} is no state of a training, which has {', '.join(_PARTS)}; {_ANEW}")
    return state


def check_goes_on(folder: Path, state: Mapping[str, Any], fingerprint: str, terms: Mapping[str, str]) -> None:
    """Raise ResumeError unless a state was made under the conditions of the training that is to resume from it.

    Older states have no fingerprint or no terms; these are not checked.
    """
    path = folder / STATE_FILE
    if state.get("fingerprint", fingerprint) != fingerprint:
        raise ResumeError(
            f"{path} is of a denoiser that began with another tokenizer, whose latents meant something else: give"
            " that one, or another run folder, or delete this one to begin anew"
        )
    began = state.get("terms", {})
    for name, value in terms.items():
        if began.get(name, value) != value:
            raise ResumeError(
                f"{path} began with {name} {began[name]}, not {value}: give what it began with, or {_ANEW}"
            )


@contextlib.contextmanager
def loading(folder: Path) -> Iterator[None]:
    """Context for loading a state into what is trained: one that does not fit becomes ResumeError."""
    try:
        yield
    except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ResumeError(
            f"{folder / STATE_FILE} does not fit what is to be trained: {_first_line(error)}; give the recipe that it"
            f" began with, or {_ANEW}"
        ) from error


def _first_line(error: Exception) -> str:
    """The message of an error in one line, without locations in the library's own code."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join(lines[:2])[:200].rstrip(".;") or type(error).__name__
