"""Every name in the prose of ARCHITECTURE.md is a file, a room, or something that the code defines."""

from __future__ import annotations

import ast
import re
from pathlib import Path, PurePosixPath
from typing import Any

import pytest

NAME = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"\w[\w/-]*[./][\w/]*")
DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
PRODUCT = ("ardy", "server", "client", "compliance", "proto")


class Defined:
    """The names that exist: paths of files and folders, and every name that the product's Python code defines."""

    def __init__(self, root: Path, files: tuple[Path, ...]) -> None:
        self.paths = {path.as_posix() for file in files for path in (file, *file.parents)} - {"."}
        sources = [path for path in files if path.suffix == ".py" and path.parts[0] in PRODUCT]
        self.of: dict[str, set[str]] = {}
        for path in sources:
            for name in definitions(ast.parse((root / path).read_text(encoding="utf-8"))):
                self.of.setdefault(name, set()).add(path.as_posix())

    def has(self, name: str) -> bool:
        """Whether a name, as the page writes it, exists."""
        if "/" in name or PurePosixPath(name).suffix in {".py", ".md", ".proto"}:
            return self._has_path(name.rstrip("/"))
        if self._has_path(name.replace(".", "/")):
            return True
        of, _, last = name.rpartition(".")
        places = self.of.get(last, set())
        in_module = any(f"/{place}".endswith(f"/{of.replace('.', '/')}.py") for place in places)
        return bool(places) and (not of or in_module or bool(places & self.of.get(of, set())))

    def _has_path(self, path: str) -> bool:
        ends = tuple(f"/{path}{end}" for end in ("", ".py"))
        return any(f"/{known}".endswith(ends) for known in self.paths)


def definitions(tree: ast.AST) -> set[str]:
    """Classes, functions, fields, variables."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.id if isinstance(node, ast.Name) else node.attr)
    return found


@pytest.fixture(scope="module")
def defined(repository: Any) -> Defined:
    return Defined(repository.root, repository.files)


def names_on(page: str) -> list[str]:
    """The names in backticks outside of the tree, without settings and shell lines."""
    prose = page.partition("## The tree")[0]
    return [name for name in NAME.findall(prose) if PATH.fullmatch(name) or DOTTED.fullmatch(name)]


def test_every_name_exists(defined: Defined, repository: Any) -> None:
    names = names_on((repository.root / "ARCHITECTURE.md").read_text(encoding="utf-8"))
    assert sorted({name for name in names if not defined.has(name)}) == []
    assert len(names) > 100


@pytest.mark.parametrize("name", ["rpc/nothing.py", "engine.nowhere", "NoSuchClass", "Scheduler.play", "nobody_knows"])
def test_missing_name_is_found(name: str, defined: Defined) -> None:
    assert not defined.has(name)


@pytest.mark.parametrize(
    "name", ["rpc/convert", "engine.scheduling.scheduler", "Scheduler.schedule", "peers.py", "proto/"]
)
def test_existing_name_is_recognised(name: str, defined: Defined) -> None:
    assert defined.has(name)
