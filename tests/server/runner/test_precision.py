"""The precision's names, and what auto takes."""

from __future__ import annotations

import pytest
import torch

from motiongen_server.runner import precision
from motiongen_server.runner.precision import choose_precision


def test_names() -> None:
    assert choose_precision("float32", "cpu") is torch.float32
    assert choose_precision("bfloat16", "cpu") is torch.bfloat16


@pytest.mark.parametrize(("in_hardware", "expected"), [(True, torch.bfloat16), (False, torch.float32)])
def test_auto_takes_bfloat16_where_it_is_in_hardware(
    monkeypatch: pytest.MonkeyPatch, in_hardware: bool, expected: torch.dtype
) -> None:
    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda device: in_hardware)
    assert choose_precision("auto", "cpu") is expected


def test_another_name_is_refused() -> None:
    with pytest.raises(ValueError, match="'int4'; it must be auto, float32 or bfloat16"):
        choose_precision("int4", "cpu")
