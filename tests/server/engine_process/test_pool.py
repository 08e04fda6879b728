"""What engine processes are told by the pool that starts them."""

from __future__ import annotations

import math

import pytest

from motiongen_server.settings import SettingError
from tests.server.engine_process.audience import pool_of


@pytest.mark.parametrize(("engines", "given", "load"), [(2, None, "0.87"), (3, None, "0.75"), (3, 0.5, "0.5")])
def test_engines_know_up_to_where_they_are_filled(
    engines: int, given: float | None, load: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr("motiongen_server.devices.quota_cores", lambda: math.inf)
    with pool_of("tell_load", engines, admit_load=given) as (pool, _), pytest.raises(SettingError, match=load):
        pool.load("one")
