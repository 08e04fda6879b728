"""The denoiser as it is served: many rows at once, without padding, nothing computed twice, in one precision.

It gives what `motiongen_ardy.denoiser.guidance.guided_prediction` gives; `tests/ardy/test_packed.py` compares them.
"""

from motiongen_ardy.packed.batch import PackedBatch
from motiongen_ardy.packed.conditions import RowConditions, RowRequest
from motiongen_ardy.packed.denoiser import PackedDenoiser

__all__ = ["PackedBatch", "PackedDenoiser", "RowConditions", "RowRequest"]
