"""The client's own tests need nothing but the client: they run with the oldest versions of what it depends on."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

ALLOWED = {"motiongen", "motiongen_client", "tests", "grpc", "google", "numpy", "hypothesis", "pytest"}
FILES = sorted((ROOT / "tests" / "client").glob("**/*.py"))


def packages(source: str) -> set[str]:
    """Of all imports in a module, those within functions too."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.partition(".")[0])
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_they_import_the_client_and_what_it_needs(path: Path) -> None:
    assert packages(path.read_text(encoding="utf-8")) - ALLOWED - set(sys.stdlib_module_names) == set()


def test_imports_within_functions_are_seen() -> None:
    assert packages("def f():\n    import torch.nn\n    from yaml import load") == {"torch", "yaml"}
