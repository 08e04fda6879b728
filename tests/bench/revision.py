"""A revision of this repository to measure: the current checkout, or a commit in a temporary worktree."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.bench.machine import ROOT

# The source folders of the distributions, in any revision.
_PARTS = (".", "ardy", "server", "client/python", "client/tools")
_COMMANDS = ("client/tools/motiongen_tools", "client/python/motiongen_client")


@dataclass(frozen=True)
class Revision:
    """name: for tables. tree: the folder of its files."""

    name: str
    tree: Path

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables that run this revision's code, whatever is installed."""
        parts = [self.tree / part for part in _PARTS if (self.tree / part / "pyproject.toml").exists()]
        paths = [*map(str, parts), str(self.tree / "proto/python")]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}

    @property
    def motiongen(self) -> list[str]:
        """Its command `motiongen`."""
        module = next(path for path in map(Path, _COMMANDS) if (self.tree / path / "__main__.py").exists())
        return [sys.executable, "-m", module.name]


@contextmanager
def commit_tree(commit: str) -> Iterator[Revision]:
    """A commit, in a worktree that is removed afterwards. Raises CalledProcessError if there is no such commit."""

    def git(*arguments: str) -> None:
        subprocess.run(["git", "-C", str(ROOT), *arguments], check=True, capture_output=True)

    with tempfile.TemporaryDirectory(prefix="motiongen-revision-") as folder:
        tree = Path(folder) / "tree"
        git("worktree", "add", "--detach", str(tree), commit)
        try:
            yield Revision(commit, tree)
        finally:
            git("worktree", "remove", "--force", str(tree))
