"""Reading BVH: hierarchy, channel orders, and invalid files."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from motiongen_ardy.data.bvh import Bvh, BvhError, parse_bvh, read_bvh

CLIP = """HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {
    OFFSET 0 10 0
    CHANNELS 3 Yrotation Zrotation Xrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 90 0 0 0 90 0 0 0
5 90 0 90 0 0 0 90 0
"""


@pytest.fixture
def clip() -> Bvh:
    return parse_bvh(CLIP)


def test_hierarchy_and_frame_rate_are_read(clip: Bvh) -> None:
    assert clip.joint_names == ("Hips", "Spine")
    assert clip.parents == (-1, 0)
    assert clip.num_frames == 2
    assert clip.fps == 30
    assert clip.end_sites == {1: (0.0, 5.0, 0.0)}


def test_position_channels_replace_the_offset(clip: Bvh) -> None:
    _, positions = clip.global_pose()
    torch.testing.assert_close(positions[0, 0], torch.tensor([0.0, 90.0, 0.0]).double())
    torch.testing.assert_close(positions[1, 0], torch.tensor([5.0, 90.0, 0.0]).double())


def test_rotations_multiply_in_channel_order_and_turn_the_child(clip: Bvh) -> None:
    rotations, positions = clip.global_pose()
    # Frame 0: a quarter turn about +Y takes +Z to +X and leaves the spine upright.
    torch.testing.assert_close(rotations[0, 0] @ torch.tensor([0.0, 0, 1]).double(), torch.tensor([1.0, 0, 0]).double())
    torch.testing.assert_close(positions[0, 1], torch.tensor([0.0, 100.0, 0.0]).double())
    # Frame 1: a quarter turn about +Z lays the spine along -X.
    torch.testing.assert_close(positions[1, 1], torch.tensor([-5.0, 90.0, 0.0]).double())
    half_turn = torch.tensor([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]]).double()
    torch.testing.assert_close(rotations[1, 1], half_turn)


def test_the_order_of_channels_changes_the_rotation() -> None:
    angles = "0 90 0 30 40 50 0 0 0"
    one = CLIP.replace("0 90 0 0 0 90 0 0 0", angles)
    other = one.replace("Zrotation Xrotation Yrotation", "Xrotation Yrotation Zrotation")
    assert not torch.allclose(parse_bvh(one).pose()[0][0, 0], parse_bvh(other).pose()[0][0, 0])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("HIERARCHY", "HELLO"),
        ("OFFSET 0 10 0", "OFFSET 0 ten 0"),
        ("CHANNELS 3", "CHANNELS 4"),
        ("Zrotation Xrotation Yrotation", "Zrotation Xrotation Wrotation"),
        ("Frames: 2", "Frames: 3"),
        ("Frame Time: 0.0333333", "Frame Time: 1e-310"),
        ("Frame Time: 0.0333333", "Frame Time: 0"),
        ("Frame Time: 0.0333333", "Frame Time: 33.3333"),
        ("Frame Time: 0.0333333", "Frame Time: 1e30"),
        ("0 90 0 0 0 90 0 0 0", "0 90 0 0 0 90 0 0"),
        ("0 90 0 0 0 90 0 0 0", "0 90 0 0 0 nan 0 0 0"),
    ],
)
def test_an_invalid_file_is_refused_with_its_name_and_line(old: str, new: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.bvh"
    path.write_text(CLIP.replace(old, new, 1))
    with pytest.raises(BvhError, match=r"broken\.bvh, line \d+"):
        read_bvh(path)


def test_angles_are_in_degrees(clip: Bvh) -> None:
    turned = clip.pose()[0][0, 0]
    assert math.degrees(math.atan2(float(turned[0, 2]), float(turned[2, 2]))) == pytest.approx(90)
