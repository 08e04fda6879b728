"""make_secrets.sh creates all secrets or none, so that it can be run again."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.conftest import ROOT

OPENSSL = """#!/bin/sh
while [ $# -gt 0 ]; do case $1 in -keyout | -out) : > "$2" ;; esac; shift; done
echo 00ff
"""
IDENTITY = """#!/bin/sh
if [ "$1" != --help ]; then kill -{signal} $PPID; fi
"""


def program(path: Path, text: str) -> Path:
    path.write_text(text)
    path.chmod(0o755)
    return path


HEEDING = """
import os, signal, sys

for number in (signal.SIGINT, signal.SIGHUP):
    signal.signal(number, signal.SIG_DFL)
os.execvp(sys.argv[1], sys.argv[1:])
"""
"""Resets signals that the tests ignore when they run in the background or by nohup: a shell cannot handle a signal that
was ignored when it started."""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_script_leaves_no_secrets(number: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "programs").mkdir()
    program(tmp_path / "programs" / "openssl", OPENSSL)
    identity = program(tmp_path / "identity", IDENTITY.format(signal=number.name.removeprefix("SIG")))
    path = f"{tmp_path / 'programs'}:{os.environ['PATH']}"
    made = subprocess.run(
        [sys.executable, "-c", HEEDING, "sh", str(ROOT / "deploy" / "make_secrets.sh"), str(tmp_path / "its secrets")],
        env={**os.environ, "PATH": path, "IDENTITY": str(identity)},
        check=False,
    )
    assert made.returncode == 128 + number
    assert not (tmp_path / "its secrets").exists()


SAYS_MORE = """#!/bin/sh
echo "WARNING: the image is of another platform" >&2
echo "token-of-$1"
printf '[tenants."%s"]\\ntokens = []\\n' "$1" >&2
"""
"""Stands in for a container engine that runs the token program, and also prints warnings."""


@pytest.mark.parametrize("to", [[], ["elsewhere/its secrets"]])
def test_relative_token_program_that_prints_warnings_is_used(to: list[str], tmp_path: Path) -> None:
    program(tmp_path / "identity", SAYS_MORE)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "deploy").mkdir()
    shutil.copy(ROOT / "deploy" / "make_secrets.sh", tmp_path / "deploy")
    made = subprocess.run(
        ["sh", "deploy/make_secrets.sh", *to],
        cwd=tmp_path, env={**os.environ, "IDENTITY": "./identity"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (made.returncode, made.stderr) == (0, "")
    folder = tmp_path / (to or ["deploy/secrets"])[0]
    tenants = tomllib.loads((folder / "tenants.toml").read_text())["tenants"]
    assert {name: entry["roles"] for name, entry in tenants.items()} == {
        "player": ["motion"],
        "prometheus": ["metrics"],
        "servers": ["text"],
    }
    assert (folder / "player.token").read_text() == "token-of-player\n"


@pytest.mark.parametrize(("given", "code"), [(["--help"], 0), (["-x"], 2), (["one", "two"], 2)])
def test_how_to_use_it_is_told_and_no_folder_is_named_after_an_option(
    given: list[str], code: int, tmp_path: Path
) -> None:
    identity = program(tmp_path / "identity", SAYS_MORE)
    made = subprocess.run(
        ["sh", str(ROOT / "deploy" / "make_secrets.sh"), *given],
        cwd=tmp_path, env={**os.environ, "IDENTITY": str(identity)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == code
    said = made.stderr if code else made.stdout
    assert "make_secrets.sh [FOLDER]\nCreate the secrets that deploy/compose.yaml needs" in said
    assert "set -eu" not in said
    assert list(tmp_path.iterdir()) == [identity]
