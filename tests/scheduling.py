"""Which tests stay together when several processes share them (`make test`)."""

from __future__ import annotations

from pathlib import PurePosixPath

from xdist.scheduler import LoadScopeScheduling

TOGETHER = frozenset({"tests/cpp"})
"""Folders whose tests share what is built once."""


def scope_of(nodeid: str) -> str:
    """What a test stays together with: its folder where that is to be, else its file."""
    path = PurePosixPath(nodeid.partition("::")[0])
    folders = [str(parent) for parent in path.parents if str(parent) in TOGETHER]
    return folders[0] if folders else str(path)


class FileScheduling(LoadScopeScheduling):
    """Files with many tests first; fixtures of a file are made once."""

    def _split_scope(self, nodeid: str) -> str:
        return scope_of(nodeid)
