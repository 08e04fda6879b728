"""The names of precisions, and which one auto chooses."""

from __future__ import annotations

import pytest
import torch

from motiongen_server.runner import precision
from motiongen_server.runner.precision import choose_precision


def test_precisions_are_chosen_by_name() -> None:
    assert choose_precision("float32", "cpu") is torch.float32
    assert choose_precision("bfloat16", "cpu") is torch.bfloat16


@pytest.mark.parametrize(
    ("in_hardware", "gain", "expected"),
    [(True, 1.6, torch.bfloat16), (True, 1.4, torch.float32), (False, 9.0, torch.float32)],
)
def test_auto_chooses_bfloat16_if_it_is_in_hardware_and_fast(
    monkeypatch: pytest.MonkeyPatch, in_hardware: bool, gain: float, expected: torch.dtype
) -> None:
    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda device: in_hardware)
    monkeypatch.setattr(precision, "product_s", lambda dtype: 1e-4 * (gain if dtype is torch.float32 else 1.0))
    assert choose_precision("auto", "cpu") is expected


def test_products_are_timed() -> None:
    assert 0 < precision.product_s(torch.float32) < 1


def test_unknown_name_is_refused() -> None:
    with pytest.raises(ValueError, match="'int4'; it must be auto, float32 or bfloat16"):
        choose_precision("int4", "cpu")
