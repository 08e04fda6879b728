"""Signals that ask a whole group of processes to stop reach engine processes from their first moment on."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from motiongen_server.engine_process import signals
from motiongen_server.engine_process.child import END_S, FreshChild
from motiongen_server.engine_process.forking import ForkServerLink

HIT_AT_ONCE = "kill -TERM $$; kill -INT $$;"
"""For a shell that is asked to stop before it could have done anything about it."""


def blocked() -> set[int]:
    return {int(each) for each in signal.pthread_sigmask(signal.SIG_BLOCK, ())}


def test_an_engine_process_that_has_just_been_started_is_not_ended_by_them(tmp_path: Path) -> None:
    child = FreshChild(("/bin/sh", "-c", f"{HIT_AT_ONCE} exit 7"), tmp_path, {})
    assert child.end(END_S) == "ended with exit code 7"
    child.close()
    assert not blocked() & set(signals.ASKING_TO_STOP), "who starts it hears them as before"


def test_nor_is_what_engines_are_forked_from(tmp_path: Path) -> None:
    lives = tmp_path / "lives"
    # It must not end before it is asked; a shell that has waited for a command of its own holds back no signals.
    link = ForkServerLink(("/bin/sh", "-c", f"{HIT_AT_ONCE} : >{lives}; exec head -c 1 >/dev/null"))
    with pytest.raises(ChildProcessError):
        link.start(tmp_path, {})
    link.stop()
    link.join(END_S)
    assert lives.exists()


def test_what_waits_is_ignored_in_the_end() -> None:
    with signals.held_back():
        pid = os.fork()
        if not pid:
            os.kill(os.getpid(), signal.SIGTERM)
            signals.ignore()
            os.kill(os.getpid(), signal.SIGINT)
            os._exit(9 if not blocked() else 10)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 9
