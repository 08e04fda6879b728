"""The denoiser as it is served: many rows at once, without padding or repeated computation, in one precision.

Its results are those of `model.denoiser.guidance.guided_prediction`, as `tests/ardy/model/test_packed.py` checks.
"""

from motiongen_ardy.model.packed.batch import PackedBatch
from motiongen_ardy.model.packed.conditions import RowConditions, WindowVectors
from motiongen_ardy.model.packed.denoiser import PackedDenoiser

__all__ = ["PackedBatch", "PackedDenoiser", "RowConditions", "WindowVectors"]
