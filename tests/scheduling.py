"""Which tests run in the same process when several processes share them (`make test`)."""

from __future__ import annotations

from pathlib import PurePosixPath

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

TOGETHER = frozenset({"tests/cpp"})
"""Folders whose tests share a build."""


def scope_of(nodeid: str) -> str:
    """The group of tests that a test stays with: its folder if listed above, else its file."""
    path = PurePosixPath(nodeid.partition("::")[0])
    folders = [str(parent) for parent in path.parents if str(parent) in TOGETHER]
    return folders[0] if folders else str(path)


class FileScheduling(LoadScopeScheduling):
    """Runs files with many tests first; a file's fixtures are made once."""

    def remove_node(self, node: WorkerController) -> str | None:
        """Pass on only unfinished work to other processes; returns the test that ended this one.

        pytest-xdist passes on all files that the process ever had; a process that gets a finished file waits forever.
        """
        given = self.assigned_work[node]
        self.assigned_work[node] = {scope: unit for scope, unit in given.items() if not all(unit.values())}
        ended_by: str | None = super().remove_node(node)
        return ended_by

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid)
