"""Landings: a foot whose stance begins before it has reached its place goes there through the air."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

import motiongen_ardy.model.sampling.landings as module
from motiongen_ardy.model.sampling.options import FeetOptions
from motiongen_ardy.model.sampling.steps import ground_offsets

FPS = 20
FRAMES = 30


def sliding_feet(metres: float, first: int, frames: int) -> Tensor:
    """Positions (1, T, 2, 3) of both feet, which slide some metres ahead, evenly, from frame `first` on."""
    share = ((torch.arange(FRAMES) - first) / frames).clamp(0, 1)
    slipped = torch.zeros(1, FRAMES, 2, 3)
    slipped[..., 2] = metres * share[None, :, None]
    return slipped


def none_pinned(*shape: int) -> Tensor:
    return torch.zeros(*shape, dtype=torch.bool)


def placed(
    standing: Tensor, slipped: Tensor, pinned: Tensor | None = None, twisted: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Places (B, T, 2, 3) of the feet, and their turns, lifts and stances (B, T, 2)."""
    shape = standing.shape
    turned = torch.zeros(shape) if twisted is None else twisted
    pins = none_pinned(*shape) if pinned is None else pinned
    offsets, turn, lift, stands = ground_offsets(
        standing, slipped, turned, torch.ones(shape[:2]), pins, fps=FPS, options=FeetOptions()
    )
    return slipped + offsets, turned + turn, lift, stands


def fastest(places: Tensor) -> float:
    return float((places[:, 1:] - places[:, :-1]).norm(dim=-1).max()) * FPS


def hardest(places: Tensor) -> float:
    return float((places[:, 2:] - 2 * places[:, 1:-1] + places[:, :-2]).norm(dim=-1).max()) * FPS**2


def stands_from(first: int) -> Tensor:
    return (torch.arange(FRAMES) >= first)[None, :, None].repeat(1, 1, 2)


def test_a_foot_that_lands_too_far_from_its_place_takes_a_step() -> None:
    places, _, lift, stands = placed(stands_from(1), sliding_feet(0.44, 1, 12))
    assert fastest(places) < 4.0, "a jump would be 8.8 m/s"
    assert hardest(places) < 1.5 * module.ACCELERATION_M_S2
    in_air = ~stands[0, 1:, 0]
    assert 3 <= int(in_air.sum()) <= 6
    assert (lift[0, 1:, 0] > 0).equal(in_air), "it is lifted only while it moves"
    assert float(lift.max()) > 0.04
    down = places[0, 1:, 0][~in_air]
    assert float((down - down[0]).norm(dim=-1).max()) < 1e-4, "a standing foot does not move"


def test_a_short_step_takes_frames_from_both_stances() -> None:
    standing = stands_from(0)
    standing[:, 12] = False
    places, _, _, stands = placed(standing, sliding_feet(0.4, 12, 6))
    air = (~stands[0, :, 0]).nonzero().flatten().tolist()
    assert air[0] < 12 < air[-1]
    assert len(air) <= 6
    assert hardest(places[:, :, :1]) < 1.5 * module.ACCELERATION_M_S2


def test_a_foot_that_turns_far_between_stances_is_given_another_frame() -> None:
    standing, twisted = stands_from(0), torch.zeros(1, FRAMES, 2)
    standing[:, 12] = False
    twisted[:, 13:] = 1.3 * ((torch.arange(13, FRAMES) - 12) / 6).clamp(max=1)[:, None]
    _, turned, lift, stands = placed(standing, torch.zeros(1, FRAMES, 2, 3), twisted=twisted)
    assert (~stands[0, :, 0]).nonzero().flatten().tolist() == [12, 13]
    assert lift[0, 12:14].gt(0).all()
    toes = module.SOLE_M * turned[..., None]
    assert hardest(toes) < module.ACCELERATION_M_S2


def test_a_foot_that_lands_in_time_is_left_alone() -> None:
    standing = stands_from(0)
    standing[:, 8:16] = False
    slipped = sliding_feet(0.35, 8, 8)
    kept = torch.zeros(1, FRAMES, 2, 4)
    number = standing.logical_not().cumsum(dim=1).clamp(max=2)
    assert module.late_landings(kept, standing, number, none_pinned(1, FRAMES, 2), FPS) is None
    _, _, lift, stands = placed(standing, slipped)
    assert stands.equal(standing)
    assert not lift.any()


def test_feet_stay_on_nearby_goals() -> None:
    standing, slipped = stands_from(1), sliding_feet(0.44, 1, 12)
    pinned = none_pinned(1, FRAMES, 2)
    pinned[:, 3, 0] = True
    places, _, lift, stands = placed(standing, slipped, pinned)
    torch.testing.assert_close(places[0, 3, 0], slipped[0, 3, 0])
    assert lift[0, 3, 0] == 0
    assert stands[0, 3, 0]


@pytest.mark.parametrize("on_a_gpu", [False, True])
def test_a_row_does_not_depend_on_the_others_in_its_batch(on_a_gpu: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if on_a_gpu:
        monkeypatch.setattr(module, "_all_in_time", lambda missing: False)
    rows = [
        (stands_from(1), sliding_feet(0.44, 1, 12)),
        (stands_from(0), sliding_feet(0.02, 3, 9)),
        (stands_from(5), sliding_feet(0.3, 4, 3)),
    ]
    together = placed(*(torch.cat(parts) for parts in zip(*rows, strict=True)))
    monkeypatch.undo()
    for row, (standing, slipped) in enumerate(rows):
        for found, alone in zip(together, placed(standing, slipped), strict=True):
            assert torch.equal(found[row : row + 1], alone)
