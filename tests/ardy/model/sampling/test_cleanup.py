"""Foot clean-up: standing feet stay in place and on the ground, also across windows; the body keeps its path."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import rotation_y
from motiongen_ardy.model.sampling.correct import correct_window
from motiongen_ardy.model.sampling.options import FeetOptions, SamplingOptions
from motiongen_ardy.model.sampling.pose import Poses
from motiongen_ardy.model.sampling.stance import contact_states, pace_of
from tests.ardy.model.sampling.conftest import Stand

CLEAN = SamplingOptions(clean_feet=True)


def sway(num_frames: int, metres: float = 0.05) -> Tensor:
    frames = torch.arange(num_frames) / 20
    moves = torch.zeros(num_frames, 3)
    moves[:, 2] = metres * torch.sin(2 * torch.pi * frames / 2)
    return moves


def glide(num_frames: int, speed_m_s: float) -> Tensor:
    moves = torch.zeros(num_frames, 3)
    moves[:, 2] = speed_m_s / 20 * torch.arange(num_frames)
    return moves


def cleaned(layout: Representation, features: Tensor, history: int = 1, options: SamplingOptions = CLEAN) -> Tensor:
    """Natural features of history and corrected frames."""
    new = correct_window(layout, features[:, :history], features[:, history:], None, options)
    return layout.denormalize(torch.cat([features[:, :history], new], dim=1))


def feet(layout: Representation, features: Tensor) -> Tensor:
    return layout.positions(features)[:, :, list(layout.skeleton.contact_joints)]


def test_feet_of_a_swaying_body_stay_where_the_history_put_them(layout: Representation, stand: Stand) -> None:
    features = stand(sway(41))
    before, after = layout.denormalize(features), cleaned(layout, features)
    assert (feet(layout, before) - feet(layout, before)[:, :1]).norm(dim=-1).max() > 0.03
    assert (feet(layout, after) - feet(layout, after)[:, :1]).norm(dim=-1).max() < 1e-3
    torch.testing.assert_close(after[..., [0, 2]], before[..., [0, 2]])
    hands = [layout.skeleton.left_hand[0], layout.skeleton.right_hand[0]]
    moved = (layout.positions(after) - layout.positions(before))[:, :, hands]
    assert moved.norm(dim=-1).max() < 1e-4


def test_stances_continue_across_windows(layout: Representation, stand: Stand) -> None:
    features = stand(sway(81))
    whole = layout.normalize(cleaned(layout, features[:, :41]))
    second = correct_window(layout, whole, features[:, 41:], None, CLEAN)
    both = layout.denormalize(torch.cat([whole, second], dim=1))
    assert (feet(layout, both) - feet(layout, both)[:, :1]).norm(dim=-1).max() < 1e-3


def test_corrected_features_are_consistent_with_each_other(layout: Representation, stand: Stand) -> None:
    after = cleaned(layout, stand(sway(41)))[:, 1:]
    positions = layout.positions(after)
    torch.testing.assert_close(layout.positions_block(after)[..., 1:, :], positions[..., 1:, :], atol=1e-5, rtol=0)
    steps = (positions[:, 1:] - positions[:, :-1]).flatten(2) * layout.fps
    torch.testing.assert_close(after[:, :-1, layout.velocity_block], steps, atol=1e-3, rtol=0)
    assert (after[..., layout.contact_block] == 1).all()


def test_sunk_and_floating_feet_are_brought_to_the_ground(layout: Representation, stand: Stand) -> None:
    options = FeetOptions()
    for height in (-0.03, 0.03):
        moves = torch.zeros(41, 3)
        moves[:, 1] = height
        features = stand(torch.zeros(41, 3))
        shifted = features + stand(moves) * 0
        shifted[..., 1] += height
        after = feet(layout, cleaned(layout, shifted))
        late = after[0, options.fade_frames + 1 :, :, 1]
        torch.testing.assert_close(late[:, 1::2], torch.full_like(late[:, 1::2], options.toe_m), atol=3e-3, rtol=0)
        torch.testing.assert_close(late[:, 0::2], torch.full_like(late[:, 0::2], options.heel_m), atol=3e-3, rtol=0)


def test_a_gliding_body_takes_steps(layout: Representation, stand: Stand) -> None:
    after = feet(layout, cleaned(layout, stand(glide(41, 0.8))))
    speeds = (after[0, 1:] - after[0, :-1])[..., [0, 2]].norm(dim=-1) * 20
    slowest = speeds.amin(dim=-1)
    assert slowest.median() < 0.02
    assert slowest.mean() < 0.25 * 0.8
    assert after[..., 0::2, 1].max() > 0.07 + 0.03  # a heel is lifted


def test_legs_stay_bent_and_keep_their_length(layout: Representation, stand: Stand) -> None:
    positions = layout.positions(cleaned(layout, stand(sway(41, 0.25))))
    for side in ("Left", "Right"):
        hip, knee, ankle = (
            positions[..., layout.skeleton.index(side + joint), :] for joint in ("UpLeg", "Leg", "Foot")
        )
        upper, lower = (knee - hip).norm(dim=-1), (ankle - knee).norm(dim=-1)
        assert (upper - upper[0, 0]).abs().max() < 1e-4
        assert (lower - lower[0, 0]).abs().max() < 1e-4
        assert ((ankle - hip).norm(dim=-1) < 0.9951 * (upper + lower)).all()


def test_feet_in_the_air_are_left_alone(layout: Representation, stand: Stand) -> None:
    moves = glide(41, 1.5)
    moves[:, 1] = 0.4
    features = stand(moves)
    features[..., 1] += 0.4
    features[..., layout.contact_block] = 0
    before, after = layout.denormalize(features), cleaned(layout, features)
    torch.testing.assert_close(layout.positions(after), layout.positions(before), atol=1e-4, rtol=0)


@pytest.mark.parametrize("history", [0, 1, 16])
def test_rows_do_not_depend_on_each_other(layout: Representation, stand: Stand, history: int) -> None:
    rows = torch.cat([stand(glide(41 + history, 0.7)), stand(sway(41 + history)), stand(sway(41 + history, 0.2))])
    together = cleaned(layout, rows, history)
    alone = torch.cat([cleaned(layout, row[None], history) for row in rows])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=0)


def test_without_corrections_the_features_are_returned_unchanged(layout: Representation, stand: Stand) -> None:
    features = stand(sway(41))
    assert correct_window(layout, features[:, :1], features, None, SamplingOptions()) is features


def turned(layout: Representation, features: Tensor, radians: float) -> Tensor:
    """The same frames (1, T, D), their body turned about the root by an angle that grows evenly to `radians`."""
    natural = layout.denormalize(features)
    poses = Poses.of(layout, natural)
    turn = rotation_y(torch.linspace(0, radians, natural.shape[1]))
    poses.turn(range(layout.skeleton.num_joints), turn[None, :, None])
    moved = poses.features(natural[..., layout.heading_block])
    moved[..., layout.contact_block] = 1.0
    return layout.normalize(moved)


def test_standing_feet_keep_their_direction_while_the_body_turns(layout: Representation, stand: Stand) -> None:
    features = turned(layout, stand(torch.zeros(41, 3)), 0.2)
    before, after = layout.denormalize(features), cleaned(layout, features)
    assert (feet(layout, before) - feet(layout, before)[:, :1]).norm(dim=-1).max() > 0.03
    assert (feet(layout, after) - feet(layout, after)[:, :1]).norm(dim=-1).max() < 2e-3
    knees = [layout.skeleton.index(side + "Leg") for side in ("Left", "Right")]
    assert (layout.positions(after) - layout.positions(before))[0, -1, knees].norm(dim=-1).min() > 0.005


def test_a_body_that_turns_on_the_spot_takes_steps(layout: Representation, stand: Stand) -> None:
    after = feet(layout, cleaned(layout, turned(layout, stand(torch.zeros(41, 3)), 2.0)))
    up = after[0, :, 1::2, 1] > 0.03
    assert up.any(dim=0).all()
    assert not up.all(dim=-1).any()  # one after the other
    low = ~(up[1:] | up[:-1])
    toes = (after[0, 1:, 1::2] - after[0, :-1, 1::2])[..., [0, 2]].norm(dim=-1)
    assert (toes * low).sum(dim=0).mean() < 0.02  # feet move only in the air
    sole = (after[0, -1, 1::2] - after[0, -1, 0::2])[:, [0, 2]]
    assert (torch.atan2(sole[:, 0], sole[:, 1]) > 2.0 - FeetOptions().twist_rad).all()


def test_feet_much_slower_than_the_root_are_standing() -> None:
    options, frames = FeetOptions(), torch.arange(20) / 20
    places = torch.zeros(1, 20, 4, 3)
    places[..., 1] = torch.tensor([options.heel_m, options.toe_m] * 2)
    places[..., 2] = 0.5 * frames[:, None]
    words = torch.zeros(1, 20, 4)
    for pace, stands in ((0.5, False), (3.0, True)):
        root = torch.zeros(1, 20, 3)
        root[..., 2] = pace * frames
        found = pace_of(root, 20)
        assert found == pytest.approx(pace, abs=1e-4)
        assert bool(contact_states(words, places, found, 20, options).all()) is stands
