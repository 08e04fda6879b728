"""A command that is told to end cleans up and leaves no server behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.waiting import until

UNDER_WAY = """
import asyncio, signal, sys
from motiongen_tools import cli, cli_catalog

signal.signal(signal.SIGINT, signal.default_int_handler)  # where the tests run in the background it is ignored
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # where they run by nohup

async def work(options):
    try:
        print("under way", flush=True)
        await asyncio.Event().wait()
    finally:
        print("put in order", flush=True)

cli_catalog.catalog = work
sys.exit(cli.run(["catalog"]))
"""

STARTING = """
import signal, sys
from motiongen_tools import cli

signal.signal(signal.SIGINT, signal.default_int_handler)

sys.executable = sys.argv[1]
sys.exit(cli.run(["generate", "walk", "--start-server", "--out", sys.argv[2]]))
"""


BEGINNING = """
import os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)

class Interrupts:
    @staticmethod
    def find_spec(name, *_):
        if name == "motiongen_tools.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupts)
from motiongen_tools.__main__ import main
sys.exit(main())
"""


JUST_BEGUN = """
import asyncio, os, signal, sys
from motiongen_tools import cli

signal.signal(signal.SIGINT, signal.default_int_handler)
place, name = {"arguments": (cli, "parse"), "loop": (asyncio.events, "new_event_loop")}[sys.argv[1]]
usual = getattr(place, name)

def interrupted(*given):
    os.kill(os.getpid(), signal.SIGINT)
    return usual(*given)

setattr(place, name, interrupted)
sys.exit(cli.run(["catalog"]))
"""

VIEWING = """
import sys
from motiongen_tools import cli

sys.stdout.reconfigure(line_buffering=True)
sys.exit(cli.run(sys.argv[1:]))
"""


def started(program: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_command_that_gets_a_signal_cleans_up_and_exits(number: signal.Signals) -> None:
    with started(UNDER_WAY) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "under way\n"
        process.send_signal(number)
        out, error = process.communicate()
    said = "interrupted\n" if number == signal.SIGINT else "terminated\n"
    assert (process.returncode, out, error) == (128 + number, "put in order\n", said)


def test_a_server_that_is_being_started_is_ended_with_the_command(tmp_path: Path) -> None:
    pretended = tmp_path / "python"
    pretended.write_text(f"#!/bin/sh\necho $$ > {tmp_path}/new && mv {tmp_path}/new {tmp_path}/pid\nexec sleep 1000\n")
    pretended.chmod(0o755)
    with started(STARTING, str(pretended), str(tmp_path / "walk.npz")) as process:
        until((tmp_path / "pid").exists)
        process.send_signal(signal.SIGTERM)
        process.communicate()
    assert process.returncode == 143
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


def test_ctrl_c_while_a_server_starts_is_reported_as_an_interruption(tmp_path: Path) -> None:
    """A terminal sends it to all processes, so that a server that is loading ends too."""
    pretended = tmp_path / "python"
    waits = f"trap 'exit 0' INT; mkfifo {tmp_path}/end; echo > {tmp_path}/started; read _ < {tmp_path}/end"
    pretended.write_text(f"#!/bin/bash\n{waits}\n")
    pretended.chmod(0o755)
    with subprocess.Popen(
        [sys.executable, "-c", STARTING, str(pretended), str(tmp_path / "walk.npz")],
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        until((tmp_path / "started").exists)
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate()
    assert (process.returncode, error) == (130, "interrupted\n")


def test_ctrl_c_during_the_imports_leaves_no_traceback() -> None:
    with started(BEGINNING) as process:
        _, error = process.communicate()
    assert (process.returncode, error) == (-signal.SIGINT, "")


@pytest.mark.parametrize("where", ["arguments", "loop"])
def test_ctrl_c_at_the_start_of_a_command_prints_only_interrupted(where: str) -> None:
    with started(JUST_BEGUN, where) as process:
        _, error = process.communicate()
    assert (process.returncode, error) == (130, "interrupted\n")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_viewer_that_gets_a_signal_prints_one_word_and_exits(number: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "build").mkdir()
    (tmp_path / "build" / "three.module.js").write_text("export {};")
    view = ["view", "--server", "localhost:1", "--port", "0", "--three", str(tmp_path)]
    with started(VIEWING, *view) as process:
        assert process.stdout is not None
        page = process.stdout.readline().split()[-1]
        with urllib.request.urlopen(page) as answer:  # it listens before it prints its address
            assert answer.status == 200
        bridge = urlsplit(page)
        assert bridge.hostname is not None
        assert bridge.port is not None
        with socket.create_connection((bridge.hostname, bridge.port)) as upload:
            head = f"POST /session/main HTTP/1.1\r\nHost: {bridge.netloc}\r\nExpect: 100-continue"
            upload.sendall(f"{head}\r\nContent-Length: 9\r\n\r\n".encode())
            assert upload.recv(1024).startswith(b"HTTP/1.1 100 ")  # it waits for a body that never comes
            process.send_signal(number)
            _, error = process.communicate()
    said = "terminated\n" if number == signal.SIGTERM else "interrupted\n"
    assert (process.returncode, error) == (128 + number, said)
