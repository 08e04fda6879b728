"""The denoiser as it is served: many rows at once, without padding, nothing computed twice, in one precision.

It gives what `ardy.denoiser.guidance.guided_prediction` gives; `tests/ardy/test_packed.py` compares them.
"""

from ardy.packed.batch import PackedBatch
from ardy.packed.conditions import RowConditions, RowRequest
from ardy.packed.denoiser import PackedDenoiser

__all__ = ["PackedBatch", "PackedDenoiser", "RowConditions", "RowRequest"]
