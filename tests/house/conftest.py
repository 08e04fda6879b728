"""Fixtures of the house tests: the files of the repository, and the proto generator."""

from __future__ import annotations

import importlib.util
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]
CACHES = {"__pycache__", ".mypy_cache", ".pytest_cache", ".ruff_cache", ".hypothesis"}
MADE = {".git", ".venv", "out", "build", "dist"} | CACHES


@dataclass(frozen=True)
class Repository:
    """root: the folder with the README. files: the files of the product, relative to root, sorted."""

    root: Path
    files: tuple[Path, ...]


def list_files(root: Path) -> list[Path]:
    """Files that git knows or would add; in a copy without git, every file outside the folders that tools make."""
    command = ["git", "-C", str(root), "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        names = subprocess.run(command, capture_output=True, check=True, text=True).stdout.split("\0")
        found = [Path(name) for name in names if name]
    except (OSError, subprocess.CalledProcessError):
        found = [path.relative_to(root) for path in root.rglob("*")]
    return [path for path in found if (root / path).is_file() and not is_made(path)]


def is_made(path: Path) -> bool:
    return any(part in MADE or part.endswith(".egg-info") for part in path.parts)


@pytest.fixture(scope="session")
def repository() -> Repository:
    return Repository(ROOT, tuple(sorted(list_files(ROOT))))


@pytest.fixture(scope="session")
def generator() -> ModuleType:
    """proto/generate.py as a module; it is outside every package."""
    spec = importlib.util.spec_from_file_location("generate", ROOT / "proto" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
