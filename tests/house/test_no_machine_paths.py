"""Committed files contain no absolute paths of a machine and no hosts of package registries."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

MACHINE_PATH = re.compile(r"(?<![\w.$~}/:-])/(?:home|root|work|Users|mnt|media|srv|private|tmp|farm)/[\w.-]+")
HOSTS = (
    "pypi.org",
    "pythonhosted.org",
    "download.pytorch.org",
    "npmjs.org",
    "npmjs.com",
    "ghcr.io",
    "docker.io",
    "quay.io",
)
REGISTRY = re.compile("|".join(map(re.escape, HOSTS)), re.IGNORECASE)
THIS = Path("tests/house/test_no_machine_paths.py")


def breaches(text: str) -> list[str]:
    return [match.group() for pattern in (MACHINE_PATH, REGISTRY) for match in pattern.finditer(text)]


def test_no_file_names_a_machine_path_or_a_registry(repository: Any) -> None:
    found: dict[str, list[str]] = {}
    for path in repository.files:
        content = (repository.root / path).read_bytes()
        if path != THIS and b"\0" not in content[:8192] and (lines := breaches(content.decode(errors="replace"))):
            found[path.as_posix()] = lines[:3]
    assert found == {}


@pytest.mark.parametrize(
    "text", ["open('/home/ann/clip.bvh')", "see /work/out.txt", "pip install -i https://pypi.org/simple torch"]
)
def test_machine_path_or_registry_is_found(text: str) -> None:
    assert breaches(text)


@pytest.mark.parametrize(
    "text", ["GET /livez", "out/tmp/x", "#!/usr/bin/env bash", "a/home/b", "https://arxiv.org/abs/2010.02502"]
)
def test_ordinary_text_is_allowed(text: str) -> None:
    assert not breaches(text)
