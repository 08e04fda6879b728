"""Which tests stay together when several processes share them (`make test`)."""

from __future__ import annotations

from pathlib import PurePosixPath

from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

TOGETHER = frozenset({"tests/cpp"})
"""Folders whose tests share what is built once."""


def scope_of(nodeid: str) -> str:
    """What a test stays together with: its folder where that is to be, else its file."""
    path = PurePosixPath(nodeid.partition("::")[0])
    folders = [str(parent) for parent in path.parents if str(parent) in TOGETHER]
    return folders[0] if folders else str(path)


class FileScheduling(LoadScopeScheduling):
    """Files with many tests first; fixtures of a file are made once."""

    def remove_node(self, node: WorkerController) -> str | None:
        """Leave only what is not done yet to the others; returns the test that ended the process.

        pytest-xdist hands on all that the process was ever given: who gets a file without a test to do waits for ever.
        """
        given = self.assigned_work[node]
        self.assigned_work[node] = {scope: unit for scope, unit in given.items() if not all(unit.values())}
        ended_by: str | None = super().remove_node(node)
        return ended_by

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid)
