"""constraints.txt pins everything that `make setup` installs, and the lint hook covers every file that lint reads."""

from __future__ import annotations

import tomllib
from importlib import metadata
from typing import Any

import pytest
import yaml
from identify.identify import tags_from_filename
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PARTS = ("proto", "ardy", "server", "client/python", "client/tools", "compliance")


def lines_of(text: str) -> list[str]:
    return [line for line in text.splitlines() if line and not line.startswith("#")]


@pytest.fixture(scope="module")
def asked(repository: Any) -> list[Requirement]:
    """The requirements of all parts with their extras, and those for development."""
    found = lines_of((repository.root / "requirements-dev.txt").read_text(encoding="utf-8"))
    for part in PARTS:
        project = tomllib.loads((repository.root / part / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        for each in (project["dependencies"], *project.get("optional-dependencies", {}).values()):
            found += each
    return [Requirement(each) for each in found]


def with_theirs(asked: list[Requirement]) -> set[str]:
    """The names of these requirements and of all their own requirements, as far as installed here."""
    names: set[str] = set()
    waiting = [(canonicalize_name(each.name), frozenset(each.extras)) for each in asked]
    seen = set(waiting)
    while waiting:
        name, extras = waiting.pop()
        try:
            theirs = [Requirement(each) for each in metadata.requires(name) or ()]
        except metadata.PackageNotFoundError:  # of an extra that is not needed for development
            continue
        names.add(name)
        for each in theirs:
            if each.marker is None or any(each.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
                found = (canonicalize_name(each.name), frozenset(each.extras))
                if found not in seen:
                    seen.add(found)
                    waiting.append(found)
    return names


def test_every_installed_package_is_pinned(asked: list[Requirement], repository: Any) -> None:
    lines = lines_of((repository.root / "constraints.txt").read_text(encoding="utf-8"))
    pinned = {canonicalize_name(line.partition("==")[0]) for line in lines}
    needed = {name for name in with_theirs(asked) if not name.startswith("motiongen-")}
    assert sorted(needed - pinned) == []
    assert len(needed) > 80


@pytest.mark.parametrize("name", ["a.py", "a.pyi", "a.c", "a.h", "a.cpp", "a.hpp"])
def test_lint_hook_covers_every_file_type_that_lint_reads(name: str, repository: Any) -> None:
    hooks = yaml.safe_load((repository.root / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0][
        "hooks"
    ]
    (lint,) = (hook for hook in hooks if hook["entry"] == "make lint")
    assert tags_from_filename(name) & set(lint["types_or"])
