"""The folder of a training: the state that a run goes on from, and that one run at a time writes there."""

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
    """Raised for a run folder whose training cannot go on with what is given; the message says what to do."""


class RunFolderError(ValueError):
    """Raised for a run folder that another training holds, or that cannot be written; the message says what to do."""


@contextlib.contextmanager
def held(folder: Path, rank: int = 0) -> Iterator[None]:
    """Hold a run folder, which is made if need be, against other trainings: two would each undo the other's saves.

    Of processes that train together the first one holds it for all. A process that is killed holds nothing any more.
    Raises RunFolderError where another training holds the folder, or where it cannot be made.
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
    """While something is written to a run folder: a full disk and the like become RunFolderError."""
    try:
        yield
    except (OSError, SafetensorError) as error:
        raise RunFolderError(
            f"{folder} cannot be written: {error}; what was saved before is kept: make room there, or mend what is"
            " said, and give the same command again"
        ) from error


def write_state(folder: Path, state: Mapping[str, Any]) -> None:
    """Write the state to go on from, whole or not at all. Raises OSError."""
    with written_whole(folder / STATE_FILE) as partial, partial.open("wb") as file:
        torch.save(dict(state), file)


def read_state(folder: Path) -> dict[str, Any] | None:
    """The state that a run left, None where there is none. Raises ResumeError for a file that is no state."""
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
    """Raise ResumeError unless a state was made on what the training is to go on with.

    States of before have no fingerprint or no terms; those are taken at their word.
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
    """While a state is put into what is trained: one that does not fit becomes ResumeError."""
    try:
        yield
    except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ResumeError(
            f"{folder / STATE_FILE} does not fit what is to be trained: {_first_line(error)}; give the recipe that it"
            f" began with, or {_ANEW}"
        ) from error


def _first_line(error: Exception) -> str:
    """What an error says, in a line and without the places in the library's own code."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return " ".join(lines[:2])[:200].rstrip(".;") or type(error).__name__
