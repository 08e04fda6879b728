"""The short form of `python -m tests.attack.faults`: what must hold however busy the machine is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.attack import faults
from tests.attack.faults import FAULTS, run


@pytest.mark.parametrize("word", ["killed", "disk full"])
async def test_fault_ends_only_the_affected_sessions_and_service_goes_on(word: str, tmp_path: Path) -> None:
    (fault,) = (fault for fault in FAULTS if word in fault.name)
    outcome = await run(fault, tmp_path, after_s=0.2)
    assert len(outcome.noticed.closed) == fault.lost
    assert outcome.exit_code == 0


async def test_engine_stopped_for_a_while_loses_no_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "STOPPED_S", 0.5)
    outcome = await run(FAULTS[0], tmp_path, after_s=0.2)
    assert (outcome.noticed.closed, outcome.exit_code) == ((), 0)
