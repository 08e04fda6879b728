"""Messages about missing packages name extras that exist and that contain these packages."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from motiongen_client import MissingExtra
from motiongen_tools.cli import run
from tests.conftest import ROOT

PART = ROOT / "client" / "tools"
SAID = re.compile(r"pip install '([a-z-]+)\[(\w+)\]'")


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return dict(tomllib.loads((PART / "pyproject.toml").read_text(encoding="utf-8"))["project"])


def missing_extras(path: Path) -> list[list[Any]]:
    """The arguments of each MissingExtra of a file; None for one that is not a constant."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    found = [call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "MissingExtra"]
    return [[each.value if isinstance(each, ast.Constant) else None for each in call.args] for call in found]


def test_every_extra_in_a_message_exists_and_contains_the_package(project: dict[str, Any]) -> None:
    asked = [said for path in sorted(PART.rglob("motiongen_tools/**/*.py")) for said in missing_extras(path)]
    assert len(asked) > 6
    for feature, package, extra in asked:
        names = re.split(r", | and ", package) if package else []
        if extra:
            error = MissingExtra(feature, package or "one", extra)
            assert SAID.findall(str(error)) == [(project["name"], extra)]
            brought = {re.split(r"[<>=!]", each)[0] for each in project["optional-dependencies"][extra]}
            assert set(names) <= brought, (feature, package)
        else:
            assert package in {re.split(r"[<>=!]", each)[0] for each in project["dependencies"]}, feature


@pytest.mark.parametrize("command", ["demo", "generate", "gallery"])
def test_help_names_only_existing_distributions(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([command, "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split()).replace("- ", "-")  # lines are wrapped after hyphens
    assert "motiongen package" not in said
    assert re.search(r"package motiongen\b(?!-)", said) is None
    assert "motiongen-ardy" in said or "motiongen-server" in said
