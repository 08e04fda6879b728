"""Joint positions computed for runs of frames equal those of single frames, also when a replan comes between."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_client import Frame, MotionClient, Playback, Rig
from motiongen_client import posing as posing_module
from motiongen_client.motion import Motion
from motiongen_client.posing import RUN_FRAMES, Poser
from tests.client.synthetic import synthetic_rows


def alone(rig: Rig, frame: Frame) -> np.ndarray:
    return Frame(rig, frame.index, frame.row).joint_positions_m()


@pytest.fixture
def playback(stick_rig: Rig) -> Playback:
    playback = Playback(stick_rig.frame_rate_hz, stick_rig.row_width)
    playback.announce_plan(1, 0)
    playback.add_chunk(1, 0, synthetic_rows(1, 0, 40), 4)
    return playback


def test_each_run_of_frames_is_posed_once_and_equals_single_frames(
    stick_rig: Rig, playback: Playback, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    class Counted(Motion):
        def joint_positions_m(self) -> np.ndarray:  # type: ignore[override]
            made.append(len(self))
            return super().joint_positions_m()

    monkeypatch.setattr(posing_module, "Motion", Counted)
    poser = Poser(stick_rig, playback)
    for index in range(40):
        frame = Frame(stick_rig, index, playback.row(index), poser)
        assert frame.joint_positions_m() == pytest.approx(alone(stick_rig, frame), abs=1e-6)
    assert made == [RUN_FRAMES, RUN_FRAMES, 40 - 2 * RUN_FRAMES]


def test_frames_replaced_by_a_replan_keep_their_own_poses(stick_rig: Rig, playback: Playback) -> None:
    poser = Poser(stick_rig, playback)
    old = [Frame(stick_rig, index, playback.row(index), poser) for index in (8, 12)]
    assert old[0].joint_positions_m()[0][0] == 1
    playback.announce_plan(2, 10)
    playback.add_chunk(2, 10, synthetic_rows(2, 10, 20), 4)
    new = Frame(stick_rig, 12, playback.row(12), poser)
    assert (old[1].joint_positions_m()[0][0], new.joint_positions_m()[0][0]) == (1, 2), "x is the plan's number"
    old[0].joint_positions_m()[:] = 0
    assert old[0].joint_positions_m()[0][0] == 1, "the caller owns the array that it was given"


async def test_frames_of_a_session_are_posed_in_runs(client: MotionClient) -> None:
    session = await client.open("a person walks")
    frames = [frame async for frame in session.frames(seconds=0.3, realtime=False)]
    assert all(frame.poser is frames[0].poser is not None for frame in frames)
    for frame in frames:
        assert frame.joint_positions_m() == pytest.approx(alone(session.rig, frame), abs=1e-6)
