"""The null server with a slow text encoder: `python -m tests.attack.slow_encoder_server --port 0 ...`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tests.bench.null_runner import NullEncoder
from tests.bench.null_server import main, start_null_engines

ENCODE_S = 0.1
"""Per text. Four at once make 40 per second: a fifth of what one address may ask for."""


class SlowEncoder(NullEncoder):
    """Gives the same vectors, later."""

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        time.sleep(ENCODE_S)
        return super().encode(texts)


if __name__ == "__main__":
    main(partial(start_null_engines, own_encoder=SlowEncoder))
