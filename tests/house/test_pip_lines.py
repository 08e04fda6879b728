"""Install commands in pages and messages are complete: no package index has the parts that one of ours needs."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

PARTS = ("proto", "ardy", "server", "client/python", "client/tools", "compliance")
EXTRA = re.compile(r"'(motiongen-[a-z]+)\[([a-z0-9,]+)\]'")
COMMAND = re.compile(r"pip install ([^`#)\n]*)")
FOLDER = re.compile(r"(?<![\w.])\./([a-z/]+)")
NAME = re.compile(r"[A-Za-z0-9_-]+")


@pytest.fixture(scope="module")
def projects(repository: Any) -> dict[str, dict[str, Any]]:
    """Folder of a part -> the metadata of its distribution."""
    read = {part: (repository.root / part / "pyproject.toml").read_text(encoding="utf-8") for part in PARTS}
    return {part: tomllib.loads(text)["project"] for part, text in read.items()}


@pytest.fixture(scope="module")
def texts(repository: Any) -> dict[Path, str]:
    """Everything that tells people what to type, except changelogs."""
    past, endings = ("CHANGELOG.md", "log.md"), {".md", ".py", ".service", ".yaml", ""}
    told = [path for path in repository.files if path.parts[0] != "tests" and path.name not in past]
    return {path: (repository.root / path).read_text(encoding="utf-8") for path in told if path.suffix in endings}


def test_named_extras_exist(texts: dict[Path, str], projects: dict[str, dict[str, Any]]) -> None:
    there = {(one["name"], extra) for one in projects.values() for extra in one.get("optional-dependencies", ())}
    named = {
        (path.as_posix(), name, extra)
        for path, text in texts.items()
        for name, extras in EXTRA.findall(text)
        for extra in extras.split(",")
    }
    assert sorted(each for each in named if each[1:] not in there) == []
    assert len(named) > 5


def test_install_commands_name_all_parts_that_a_part_needs(
    texts: dict[Path, str], projects: dict[str, dict[str, Any]]
) -> None:
    names = {project["name"]: part for part, project in projects.items()}
    lacking, count = [], 0
    for path, text in texts.items():
        for command in COMMAND.findall(text):
            given = set(FOLDER.findall(command))
            for part in given:
                count += 1
                needed = {match[0] for one in projects[part]["dependencies"] if (match := NAME.match(one))}
                lacking += [(path.as_posix(), part, name) for name in needed & set(names) if names[name] not in given]
    assert lacking == []
    assert count > 10
