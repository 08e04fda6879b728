"""The client's tests need only the client and its dependencies, so that they run with the oldest versions of these."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

ALLOWED = {"motiongen", "motiongen_client", "tests", "grpc", "google", "numpy", "hypothesis", "pytest"}
FILES = sorted((ROOT / "tests" / "client").glob("**/*.py"))


def packages(source: str) -> set[str]:
    """The packages that a module imports, also within functions."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.partition(".")[0])
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_client_tests_import_only_the_client_and_its_dependencies(path: Path) -> None:
    assert packages(path.read_text(encoding="utf-8")) - ALLOWED - set(sys.stdlib_module_names) == set()


def test_imports_within_functions_are_found() -> None:
    assert packages("def f():\n    import torch.nn\n    from yaml import load") == {"torch", "yaml"}
