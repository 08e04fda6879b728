"""The cost of a snapshot can be measured with the stores that exist."""

import sys

import pytest

from tests.bench import snapshot_cost


def test_every_step_of_a_snapshot_is_timed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["snapshot_cost", "--records", "64"])
    assert snapshot_cost.main() == 0
    told = capsys.readouterr().out
    assert told.count("engine process") == 1
    assert told.count("gateway: ") == 4
