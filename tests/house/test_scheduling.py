"""Distribution of tests over processes: by file, and by folder where tests share what is built once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.scheduling import TOGETHER, scope_of
from tests.waiting import LIMIT_S


@pytest.mark.parametrize(
    ("nodeid", "scope"),
    [
        ("tests/client/test_axes.py::test_a", "tests/client/test_axes.py"),
        ("tests/client/test_axes.py::test_a[x::y/z]", "tests/client/test_axes.py"),
        ("tests/cpp/test_core.py::test_a", "tests/cpp"),
        ("tests/cpp/deeper/test_core.py::test_a", "tests/cpp"),
    ],
)
def test_tests_of_a_file_or_a_shared_folder_stay_together(nodeid: str, scope: str) -> None:
    assert scope_of(nodeid) == scope


def test_folders_that_stay_together_exist(pytestconfig: pytest.Config) -> None:
    assert [folder for folder in TOGETHER if not (pytestconfig.rootpath / folder).is_dir()] == []


def test_tests_go_on_after_a_process_ends_in_the_middle_of_one(tmp_path: Path) -> None:
    """They used to wait for ever for tests that this process had finished."""
    scheduled = f"import sys\nsys.path.insert(0, {str(ROOT)!r})\n"
    hook = "from tests.scheduling import FileScheduling\ndef pytest_xdist_make_scheduler(config, log):\n"
    (tmp_path / "conftest.py").write_text(f"{scheduled}{hook}    return FileScheduling(config, log)\n")
    for number in range(6):
        (tmp_path / f"test_{number}.py").write_text("def test_a(): pass\ndef test_b(): pass\ndef test_c(): pass\n")
    # two tests, since files with more tests come first
    ends = "import os, pathlib\nmark = pathlib.Path('ended')\ndef test_d(): pass\n"
    ends += "def test_e():\n    if not mark.exists():\n        mark.touch()\n        os._exit(3)\n"
    (tmp_path / "test_ends.py").write_text(ends)
    options = ["-n", "2", "-p", "no:cacheprovider", "-o", "asyncio_default_fixture_loop_scope=function"]
    # without the variables of an outer pytest-xdist
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    command = [sys.executable, "-m", "pytest", "--rootdir", str(tmp_path), *options]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=LIMIT_S)
    assert "test_ends.py::test_e" in done.stdout
    assert "1 failed, 20 passed" in done.stdout, done.stdout[-2000:]
