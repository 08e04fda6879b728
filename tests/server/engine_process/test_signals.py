"""Stop signals to a whole process group do not end engine processes, not even in their first moment."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from motiongen_server.engine_process import signals
from motiongen_server.engine_process.child import END_S, FreshChild
from motiongen_server.engine_process.forking import ForkServerLink

HIT_AT_ONCE = "kill -TERM $$; kill -INT $$;"
"""For a shell that gets stop signals before it could have handled them."""


def blocked() -> set[int]:
    return {int(each) for each in signal.pthread_sigmask(signal.SIG_BLOCK, ())}


def test_engine_process_just_started_survives_stop_signals(tmp_path: Path) -> None:
    child = FreshChild(("/bin/sh", "-c", f"{HIT_AT_ONCE} exit 7"), tmp_path, {})
    assert child.end(END_S) == "ended with exit code 7"
    child.close()
    assert not blocked() & set(signals.ASKING_TO_STOP), "the starting process receives the signals as before"


def test_fork_server_just_started_survives_stop_signals(tmp_path: Path) -> None:
    lives = tmp_path / "lives"
    # It must not end before it is asked to fork; a shell that has waited for a command of its own blocks no signals.
    link = ForkServerLink(("/bin/sh", "-c", f"{HIT_AT_ONCE} : >{lives}; exec head -c 1 >/dev/null"))
    with pytest.raises(ChildProcessError):
        link.start(tmp_path, {})
    link.stop()
    link.join(END_S)
    assert lives.exists()


def test_ignore_discards_held_back_stop_signals() -> None:
    with signals.held_back():
        pid = os.fork()
        if not pid:
            os.kill(os.getpid(), signal.SIGTERM)
            signals.ignore()
            os.kill(os.getpid(), signal.SIGINT)
            os._exit(9 if not blocked() else 10)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 9
