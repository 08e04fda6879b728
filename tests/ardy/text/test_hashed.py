"""The encoder of hashed words: the same numbers on every machine, of a size that does not depend on the text."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_ardy.text import HashedTextEncoder

WIDTH = 4096
WALK = [1.378478, 1.771774, -0.045209]
ENCODER = HashedTextEncoder(WIDTH)


def test_words_have_the_same_vectors_on_every_machine() -> None:
    vector = HashedTextEncoder(3).encode(["walk"])[0]
    assert vector.tolist() == pytest.approx(WALK, abs=1e-6)


@pytest.mark.parametrize("text", ["walk", "a person walks forward", "one two three four five six seven eight nine ten"])
def test_numbers_are_of_standard_size_however_many_words_there_are(text: str) -> None:
    vector = ENCODER.encode([text])[0]
    assert vector.std() == pytest.approx(1, abs=0.05)
    assert vector.mean() == pytest.approx(0, abs=0.05)


def test_a_text_is_the_bag_of_its_words() -> None:
    run, fast, together = ENCODER.encode(["run", "fast", "run fast"])
    np.testing.assert_allclose(together, (run + fast) / np.sqrt(2), atol=1e-6)
    for same in ("fast run", "Run, FAST!", "  run...fast "):
        np.testing.assert_allclose(ENCODER.encode([same])[0], together, atol=1e-6)
    np.testing.assert_allclose(ENCODER.encode(["run run"])[0], np.sqrt(2) * run, atol=1e-6)
    assert abs(float(run @ fast)) < 0.1 * WIDTH, "different words point in different directions"


def test_text_without_words_is_zero() -> None:
    assert not ENCODER.encode(["?!"]).any()
