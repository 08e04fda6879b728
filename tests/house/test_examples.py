"""The README's example and every program in an examples folder run against a real server and print something."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import LIMIT_S

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "client" / "python" / "examples").glob("*.py"))
ADDRESS = "localhost:50051"


def run_program(program: str, *arguments: str, folder: Path) -> str:
    """Run Python in `folder`, warnings as errors; return what it printed. Its own errors reach the test's output."""
    command = [sys.executable, "-W", "error", program, *arguments]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, cwd=folder, timeout=LIMIT_S).stdout


def test_readme_example_runs(live_server: Any, tmp_path: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    assert ADDRESS in program
    (tmp_path / "example.py").write_text(program.replace(ADDRESS, live_server.address))
    lines = run_program("example.py", folder=tmp_path).splitlines()
    assert len(lines) == 80, "4 s at 20 frames a second"
    assert all("the hips are at" in line for line in lines)


@pytest.mark.parametrize("example", EXAMPLES)
def test_example_runs(example: str, live_server: Any, tmp_path: Path) -> None:
    assert run_program(str(ROOT / example), live_server.address, folder=tmp_path).strip()


def test_examples_exist() -> None:
    assert EXAMPLES
