"""Which names of files commands take for their output."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import pytest

from motiongen_tools.out_files import motion_path, out_path, page_path


@pytest.mark.parametrize(
    ("path", "name"),
    [
        (out_path, "walk.json"), (out_path, "a/walk.npz"), (motion_path, "walk.csv"),
        (motion_path, "walk.controller.csv"), (page_path, "a/walk.html"),
    ],
)  # fmt: skip
def test_names_with_a_known_ending_are_taken(path: Callable[[str], Path], name: str) -> None:
    assert path(name) == Path(name)


@pytest.mark.parametrize(
    ("path", "name", "allowed"),
    [
        (out_path, "walk.fbx", ".npz"), (out_path, ".npz", ".npz"), (motion_path, "walk.json", ".glb"),
        (motion_path, ".controller.csv", ".bvh"), (page_path, "walk.pdf", ".html"), (page_path, ".html", ".html"),
    ],
)  # fmt: skip
def test_other_names_are_refused_with_the_endings_that_are_known(
    path: Callable[[str], Path], name: str, allowed: str
) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=rf"'{name}' was given; allowed is .*\{allowed}"):
        path(name)
