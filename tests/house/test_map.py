"""The tree in ARCHITECTURE.md is correct and complete, files say what they are for, and the README stays short."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import pytest

LINE = re.compile(r"^(?P<indent> *)(?P<name>\S+)(?: {2,}(?P<meaning>\S.*))?$")
ROOMS = ("ardy", "server", "client", "compliance", "proto", "tests/bench")
# protoc's output has no description
GENERATED = re.compile(r"_pb2(_grpc)?\.pyi?$")
README_LINES = 120


def read_tree(page: str) -> dict[Path, str]:
    """Path -> meaning of each line of the block below the heading "The tree". Two spaces of indentation a level."""
    match = re.search(r"^## The tree\n.*?^```\n(?P<block>.*?)^```$", page, re.MULTILINE | re.DOTALL)
    assert match is not None, "ARCHITECTURE.md has no fenced block below '## The tree'"
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
    """Top-level folders, and folders of the rooms with sources in them, that the tree does not name."""
    wanted = {Path(path.parts[0]) for path in files if len(path.parts) > 1}
    for path in files:
        if path.suffix in {".py", ".proto"} and any(Path(room) in path.parents for room in ROOMS):
            wanted.add(path.parent)
    return sorted(str(path) for path in wanted if path not in tree and not any(path in name.parents for name in tree))


def first_line(path: Path, source: str) -> str:
    if path.suffix == ".proto":
        return source.partition("\n")[0].removeprefix("//").strip()
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]


@pytest.fixture(scope="module")
def tree(repository: Any) -> dict[Path, str]:
    return read_tree((repository.root / "ARCHITECTURE.md").read_text(encoding="utf-8"))


def test_every_path_of_the_tree_exists(tree: dict[Path, str], repository: Any) -> None:
    assert sorted(str(path) for path in tree if not (repository.root / path).exists()) == []


def test_tree_lists_every_folder(tree: dict[Path, str], repository: Any) -> None:
    assert missing_from(tree, repository.files) == []


def test_every_line_of_the_tree_has_an_explanation(tree: dict[Path, str]) -> None:
    assert [str(path) for path, meaning in tree.items() if not meaning] == []


def test_every_source_file_says_what_it_is_for(repository: Any) -> None:
    silent = []
    for path in repository.files:
        is_source = path.suffix in {".py", ".proto"} and not GENERATED.search(path.name)
        if is_source and any(Path(room) in path.parents for room in ROOMS):
            source = (repository.root / path).read_text(encoding="utf-8")
            if source.strip() and not first_line(path, source):
                silent.append(path.as_posix())
    assert silent == []


def test_readme_is_short(repository: Any) -> None:
    assert len((repository.root / "README.md").read_text(encoding="utf-8").splitlines()) <= README_LINES


def test_every_decision_record_has_one_row_in_the_index(repository: Any) -> None:
    folder = repository.root / "docs" / "adr"
    index = (folder / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \[(\d+)\]\(([^)]+)\) \| ([^|]+) \|", index, re.MULTILINE)
    titles = {path.name: path.read_text(encoding="utf-8").splitlines()[0] for path in folder.glob("0*.md")}
    assert sorted(name for _, name, _ in rows) == sorted(titles)
    assert [(name, title) for number, name, title in rows if titles[name] != f"# {number}. {title}"] == []


def test_missing_folder_is_found() -> None:
    page = "## The tree\n\n```\nardy/         models\n  text/       prompts\n```\n"
    files = (Path("ardy/text/one.py"), Path("ardy/data/bvh.py"), Path("docs/a.md"), Path("Makefile"))
    assert missing_from(read_tree(page), files) == ["ardy/data", "docs"]
