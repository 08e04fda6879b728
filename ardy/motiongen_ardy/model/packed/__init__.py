"""The denoiser as it is served: many rows at once, without padding, nothing computed twice, in one precision.

It gives what `model.denoiser.guidance.guided_prediction` gives; `tests/ardy/model/test_packed.py` compares them.
"""

from motiongen_ardy.model.packed.batch import PackedBatch
from motiongen_ardy.model.packed.conditions import RowConditions, WindowVectors
from motiongen_ardy.model.packed.denoiser import PackedDenoiser

__all__ = ["PackedBatch", "PackedDenoiser", "RowConditions", "WindowVectors"]
