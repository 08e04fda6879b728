"""Go's protobuf writes and reads the golden messages as ours does; needs `go`, and its modules once."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.contract.golden import FILE, golden_messages

pytestmark = pytest.mark.system

PROTOS = ROOT / "proto"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program of golden_go, with the contract's code generated for Go."""
    folder = tmp_path_factory.mktemp("golden_go")
    shutil.copytree(ROOT / "tests" / "system" / "golden_go", folder, dirs_exist_ok=True)
    plugin = folder / "protoc-gen-go"
    package = "google.golang.org/protobuf/cmd/protoc-gen-go"
    subprocess.run(["go", "build", "-o", str(plugin), package], cwd=folder, check=True)
    sources = sorted(str(path.relative_to(PROTOS)) for path in PROTOS.glob("motiongen/v1/*.proto"))
    options = [f"--plugin={plugin}", f"--go_out={folder}", "--go_opt=module=motiongen", f"-I{PROTOS}"]
    subprocess.run([sys.executable, "-m", "grpc_tools.protoc", *options, *sources], cwd=PROTOS, check=True)
    subprocess.run(["go", "build", "-o", "golden", "."], cwd=folder, check=True)
    return folder / "golden"


def test_go_writes_and_reads_every_golden_message(program: Path) -> None:
    with FILE.open("rb") as lines:
        done = subprocess.run([program], stdin=lines, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"{len(golden_messages())}\n"), done.stderr


@pytest.mark.parametrize("line", ["Ping\tclient_time_ns: 301\t08ae02\n", "Ping\tclient_time_ns: 301\t08ad0298060a\n"])
def test_wrong_line_is_reported(program: Path, line: str) -> None:
    done = subprocess.run([program], input=line, capture_output=True, text=True)
    assert done.returncode == 1
    assert "line 1" in done.stderr
