"""The wheels of all parts, installed where nothing else of this repository is visible, serve and play a stream."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("proto", "ardy", "server", "client/python", "client/tools", "compliance")
PROGRAM = """
import motiongen_ardy, motiongen_client, motiongen_server, motiongen_tools
from pathlib import Path
import sys
for part in (motiongen_ardy, motiongen_client, motiongen_server, motiongen_tools):
    assert Path(part.__file__).is_relative_to(sys.prefix), part.__file__
from motiongen_client.blocking import MotionClient
from motiongen_tools.server_process import ServerProcess
with ServerProcess(["--devices", "cpu:1", "--profile-s", "0.3"]) as server, MotionClient(server.address) as client:
    walker = client.open(prompt="a person walks forward")
    print("frames:", len([frame.joint_positions_m() for frame in walker.frames(seconds=1)]))
"""


def run(*command: str | Path, folder: Path) -> str:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [*map(str, command)], cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with our wheels, and other packages from the environment that runs the tests."""
    folder = tmp_path_factory.mktemp("wheels")
    parts = [folder / "sources" / part for part in PARTS]  # copies, since pip leaves build files in the source folders
    for part, copy in zip(PARTS, parts, strict=True):
        shutil.copytree(ROOT / part, copy, symlinks=True, ignore=shutil.ignore_patterns("build", "*.egg-info"))
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder / "wheels")]
    run(sys.executable, "-m", "pip", "wheel", *options, *parts, folder=folder)
    venv.create(folder / "venv", with_pip=True)
    python = folder / "venv" / "bin" / "python"
    wheels = sorted((folder / "wheels").glob("*.whl"))
    assert len(wheels) == len(PARTS)
    run(python, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", *wheels, folder=folder)
    # the .pth files in a folder that a .pth file names are not read, so editable installs stay invisible
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    (site / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


def test_wheels_serve_and_play_a_stream(installed: Path, tmp_path: Path) -> None:
    assert run(installed, "-W", "error", "-c", PROGRAM, folder=tmp_path).strip() == "frames: 20"


def test_commands_are_installed(installed: Path, tmp_path: Path) -> None:
    assert "usage:" in run(installed.parent / "motiongen", "--help", folder=tmp_path)
    assert "HOST:PORT" in run(installed.parent / "motiongen-compliance", "--help", folder=tmp_path)
    assert "--text-encoder" in run(installed.parent / "motiongen-server", "--help", folder=tmp_path)
