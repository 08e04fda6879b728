"""The committed code in proto/python is what the protos generate."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any


def test_generated_code_is_current(generator: ModuleType, repository: Any, tmp_path: Path) -> None:
    generator.generate(tmp_path)
    fresh = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / generator.PACKAGE).iterdir()}
    folder = repository.root / "proto" / "python" / generator.PACKAGE
    committed = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*_pb2*")}
    assert sorted(committed) == sorted(fresh), "run `make proto` and commit what it writes"
    stale = [name for name in fresh if committed[name] != fresh[name]]
    assert not stale, f"{stale} differ from what the protos generate: run `make proto` and commit"
