"""The tree in README.md is true: what it names exists, and what a reader looks for in it is there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

LINE = re.compile(r"^(?P<indent> *)(?P<name>\S+)(?: {2,}(?P<meaning>\S.*))?$")
SOURCES = {".py", ".proto"}
ROOMS = ("ardy", "server", "client/python/motiongen_client", "proto/motiongen", "examples", "tests/bench")
UNLISTED = {"__init__.py"}


def read_tree(readme: str) -> dict[Path, str]:
    """Path -> meaning of each line of the block below the heading "The tree". Two spaces of indentation a level."""
    match = re.search(r"^## The tree\n.*?^```\n(?P<block>.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    assert match is not None, "README.md has no fenced block below '## The tree'"
    tree: dict[Path, str] = {}
    above: list[str] = []
    for number, text in enumerate(match["block"].splitlines(), 1):
        line = LINE.match(text)
        assert line is not None, f"line {number} of the tree cannot be read: {text!r}"
        depth, odd = divmod(len(line["indent"]), 2)
        assert not odd, f"line {number} of the tree: {text!r} is not indented by twos"
        assert depth <= len(above), f"line {number} of the tree: {text!r} is indented too far"
        above = [*above[:depth], line["name"].rstrip("/")]
        tree[Path(*above)] = line["meaning"] or ""
    return tree


def missing_from(tree: dict[Path, str], files: tuple[Path, ...]) -> list[str]:
    """Top-level entries, sources of the rooms and their folders that the tree does not name."""
    wanted = {Path(path.parts[0]) for path in files}
    for path in files:
        in_room = any(Path(room) in path.parents for room in ROOMS)
        if in_room and path.suffix in SOURCES and path.name not in UNLISTED:
            wanted |= {path, path.parent}
    return sorted(str(path) for path in wanted - set(tree))


@pytest.fixture(scope="module")
def tree(repository: Any) -> dict[Path, str]:
    return read_tree((repository.root / "README.md").read_text(encoding="utf-8"))


def test_what_the_tree_names_exists(tree: dict[Path, str], repository: Any) -> None:
    present = set(repository.files) | {folder for path in repository.files for folder in path.parents}
    assert sorted(str(path) for path in tree if path not in present) == []


def test_the_tree_names_every_room_and_source(tree: dict[Path, str], repository: Any) -> None:
    assert missing_from(tree, repository.files) == []


def test_every_line_says_what_it_is_for(tree: dict[Path, str]) -> None:
    assert [str(path) for path, meaning in tree.items() if not meaning] == []


def test_a_file_that_is_not_named_is_missed() -> None:
    readme = "## The tree\n\n```\nardy/         models\n  text.py     prompts\n```\n"
    files = (Path("ardy/motiongen_ardy/text.py"), Path("ardy/motiongen_ardy/data/bvh.py"), Path("Makefile"))
    assert missing_from(read_tree(readme), files) == [
        "Makefile",
        "ardy/motiongen_ardy/data",
        "ardy/motiongen_ardy/data/bvh.py",
    ]
