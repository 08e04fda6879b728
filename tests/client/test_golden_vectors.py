"""The Python client reproduces the golden vectors; client/cpp/tests/core checks the C++ client with the same files."""

from __future__ import annotations

import pytest

from tests.client.golden.playback import Player
from tests.client.golden_vectors import FILES, FOLDER


def values(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def answers(lines: list[str]) -> list[str]:
    return [line.partition(" ->")[2] for line in lines]


@pytest.mark.parametrize("name", FILES)
def test_client_reproduces_the_golden_vectors(name: str) -> None:
    kept = (FOLDER / f"{name}.txt").read_text(encoding="utf-8").splitlines()
    made = list(FILES[name]())
    assert [line.partition(" ->")[0] for line in kept] == [line.partition(" ->")[0] for line in made]
    for kept_answer, answer in zip(answers(kept), answers(made), strict=True):
        assert values(answer) == pytest.approx(values(kept_answer), rel=2e-6, abs=2e-5)


def test_sampling_scripts_contain_fades_underruns_late_plans_and_cuts() -> None:
    """Late replans, cuts, underruns and jumps that fade: without them the vectors would prove little."""
    lines = (FOLDER / "sampling.txt").read_text(encoding="utf-8").splitlines()
    player = Player()
    fading = underruns = late = passed_cuts = 0
    for line in lines:
        player.tell(line.partition(" ->")[0])
        passed_cuts += player.num_passed_cuts if line.startswith("cut") else 0
        if line.startswith("sample"):
            fading += player.sampler.is_fading
            underruns = max(underruns, player.playback.underruns)
            late = max(late, player.playback.late_plans)
    assert fading > 20
    assert underruns > 3
    assert late > 0
    assert passed_cuts > 0
    assert sum(line.startswith("plan") and line.split()[3] == "1" for line in lines) > 3
