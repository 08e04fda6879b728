"""Labels and clips that the table does not have, found in the motion itself: standing, hands held up, hands lowered.

The capture data has no clips of standing, but it does contain:

* quiet stretches of gesture clips, in which no joint moves faster than `QUIET_M_S` for at least `MIN_QUIET_S`; with
  hands down they are standing, with a hand up they are holding it up;
* what follows such a stretch in a raise-up clip, which is lowering the hand again;
* gestures of one hand, in which everything but the gesturing arm stands. Replacing that arm by the mirror image of the
  resting one gives a body at rest; its quiet stretches become clips of their own (`standing_clips`). Legs, trunk, head
  and the resting arm are captured motion; the other arm is a copy, and the set records it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.data.mirror import mirror_clip
from motiongen_ardy.data.poses import smooth

QUIET_M_S = 0.25
MIN_QUIET_S = 1.0
# A hand is up when it is above its shoulder joint, and down when it is at least this far below it.
HAND_DOWN_M = 0.25
# A smaller net turn cannot be distinguished from the sway of walking.
MIN_TURN_RAD = 0.5
_ONE_HAND = re.compile(r"(?:wave|raise-up)-(left|right)-hand")
_RAISE = re.compile(r"raise-up-(left|right|both)-hands?")


@dataclass(frozen=True)
class Span:
    """Frames start .. start + length - 1 of a clip, which show `content`."""

    start: int
    length: int
    content: str


def quiet_spans(positions: Tensor, fps: float) -> list[tuple[int, int]]:
    """Stretches (first frame, end frame) of positions (T, J, 3), metres, in which every joint is quiet."""
    if positions.shape[0] < 3:
        return []
    # Over two frames, so that noise between neighbouring frames does not end a stretch.
    speed = (positions[2:] - positions[:-2]).norm(dim=-1).amax(dim=-1) * fps / 2
    quiet = torch.cat([speed[:1], speed, speed[-1:]]) < QUIET_M_S
    edges = torch.diff(quiet.int(), prepend=torch.zeros(1).int(), append=torch.zeros(1).int())
    starts, ends = torch.nonzero(edges == 1)[:, 0].tolist(), torch.nonzero(edges == -1)[:, 0].tolist()
    return [(start, end) for start, end in zip(starts, ends, strict=True) if end - start >= MIN_QUIET_S * fps]


def derived_spans(skeleton: Skeleton, content: str, positions: Tensor, fps: float) -> list[Span]:
    """Spans of a clip that deserve a narrower label than the clip's own. positions: (T, J, 3) metres."""
    if "LeftArm" not in skeleton.joint_names or "RightArm" not in skeleton.joint_names:
        return []
    raising = _RAISE.fullmatch(content)
    spans: list[Span] = []
    for start, end in quiet_spans(positions, fps):
        hands = _hands(skeleton, positions[start:end])
        if hands == {"left": "down", "right": "down"}:
            spans.append(Span(start, end - start, "stand"))
            continue
        up = [side for side, place in hands.items() if place == "up"]
        if raising is None or up != (["left", "right"] if raising.group(1) == "both" else [raising.group(1)]):
            continue
        suffix = content.removeprefix("raise-up-")
        spans.append(Span(start, end - start, f"hold-up-{suffix}"))
        if positions.shape[0] > end and set(_hands(skeleton, positions[-1:]).values()) == {"down"}:
            spans.append(Span(end, positions.shape[0] - end, f"lower-{suffix}"))
    # A second hold means that the hand did not come down in between, so only what follows the last one is lowering.
    lowering = [span for span in spans if span.content.startswith("lower-")]
    return [span for span in spans if span not in lowering[:-1]]


def turning_spans(skeleton: Skeleton, content: str, positions: Tensor, fps: float) -> list[Span]:
    """A walk with one turn, as spans of walking, turning and walking on. positions: (T, J, 3) metres.

    The turn is where the smoothed heading makes the middle 80 % of its net change, extended by 0.2 s on either side.
    Empty for other contents, and for a clip whose turn cannot be identified.
    """
    if not content.startswith("walk-turn-"):
        return []
    right, left = skeleton.hip_joints
    across = (positions[:, left] - positions[:, right]).double().numpy()
    heading = smooth(np.unwrap(np.arctan2(-across[:, 2], across[:, 0])), 0.4 * fps)
    net = heading[-1] - heading[0]
    if abs(net) < MIN_TURN_RAD or (net > 0) != content.endswith("left"):
        return []
    part = (heading - heading[0]) / net
    margin = round(0.2 * fps)
    start = max(int(np.argmax(part > 0.1)) - margin, 0)
    end = min(int(np.argmax(part > 0.9)) + margin, len(part))
    edges = [(0, start, "walk"), (start, end, content), (end, len(part), "walk")]
    return [Span(first, last - first, what) for first, last, what in edges if last > first]


def standing_clips(
    skeleton: Skeleton, content: str, quaternions: Tensor, root_positions: Tensor, fps: float
) -> list[tuple[Tensor, Tensor]]:
    """Clips of standing from a gesture of one hand: quaternions (T, J, 4) and root positions (T, 3) in metres of each.

    Empty for other contents, and for skeletons without shoulders of these names.
    """
    gesture = _ONE_HAND.fullmatch(content)
    if gesture is None or "LeftShoulder" not in skeleton.joint_names:
        return []
    resting = quaternions.clone()
    mirrored, _ = mirror_clip(skeleton, quaternions, root_positions)
    arm = _descendants(skeleton, skeleton.index(f"{gesture.group(1).capitalize()}Shoulder"))
    resting[:, arm] = mirrored[:, arm]
    _, positions = forward_kinematics(skeleton, quaternion_to_matrix(resting), root_positions)
    clips = []
    for start, end in quiet_spans(positions, fps):
        if set(_hands(skeleton, positions[start:end]).values()) == {"down"}:
            clips.append((resting[start:end], root_positions[start:end]))
    return clips


def _hands(skeleton: Skeleton, positions: Tensor) -> dict[str, str]:
    """Where each hand is throughout: up, down, or between."""
    places = {}
    for side, hand in (("left", skeleton.left_hand[0]), ("right", skeleton.right_hand[0])):
        above = positions[:, hand, 1] - positions[:, skeleton.index(f"{side.capitalize()}Arm"), 1]
        places[side] = "up" if bool((above > 0).all()) else "down" if bool((above < -HAND_DOWN_M).all()) else "between"
    return places


def _descendants(skeleton: Skeleton, joint: int) -> list[int]:
    """The joint and everything below it."""
    found = [joint]
    for child in range(joint + 1, skeleton.num_joints):
        if skeleton.parents[child] in found:
            found.append(child)
    return found
