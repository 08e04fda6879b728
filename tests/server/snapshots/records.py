"""A session record with a value in every field. `python -m tests.server.snapshots.records` saves its bytes.

Run it at a release: the file is named after the record's format, which the next version's `record` then lists as
readable.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motiongen_server.engine.types import (
    AnnouncedPlan,
    Code,
    ConstraintReached,
    Deviation,
    Direction,
    Gait,
    Guidance,
    HeadingTarget,
    HeldVelocity,
    JointRotations,
    JointTargets,
    Keyframe,
    Opened,
    Outcome,
    PlayState,
    Priority,
    Prompt,
    RootTrajectory,
    ServiceLevel,
    ServiceTier,
    SessionKey,
    SessionSnapshot,
    SessionSpec,
    UnansweredEdit,
    Warned,
    Waypoint,
)
from motiongen_server.snapshots.record import SessionRecord, write_record

KEY = SessionKey(3, 7)
RECORDS = Path(__file__).parents[2] / "data" / "records"


def a_record(taken_seq: int = 5, num_frames: int = 60) -> SessionRecord:
    """num_frames: how many frames the snapshot holds."""
    rows = np.random.default_rng(1).normal(size=(num_frames, 12)).astype(np.float32)
    matrix = np.eye(3, dtype=np.float32)[None]
    snapshot = SessionSnapshot(
        spec=SessionSpec(KEY, 1 << 63, "fake", Priority.HERO, 40, 4, Guidance(2.0, 1.5)),
        plan=9,
        last_seq=taken_seq,
        unanswered=(UnansweredEdit(4, "prompts", 80),),
        prompts=(Prompt(1, 0, None, "a person walks", np.array([1, 2], np.float32)),),
        constraints=(
            Waypoint(1, 90, 1.0, 2.0, 0.5),
            RootTrajectory(2, 95, np.zeros((3, 2), np.float32), np.zeros(3, np.float32)),
            JointTargets(3, 96, (0,), np.zeros((1, 3), np.float32), matrix, (True,)),
            Keyframe(4, 97, np.zeros((1, 3), np.float32)),
            HeadingTarget(5, 98, 1.0),
            JointRotations(6, 99, (0,), matrix),
        ),
        velocity=HeldVelocity(1.0, 0.0, None, 20, 40),
        gait=Gait("walk", "a person walks", 0.5, Direction.FORWARD, np.array([3, 4], np.float32)),
        first_frame=40,
        motion_from=40,
        rows=rows,
        committed_to=70,
        num_frames=100,
        late_frames=1,
        is_started=True,
        play_state=PlayState.PLAYING,
        underruns=2,
        plans=(AnnouncedPlan(9, 80, 90, (3,)),),
        measured_to=70,
    )
    return SessionRecord(
        tenant="studio",
        request_id="first",
        taken_seq=taken_seq,
        opened=Opened(KEY, 1 << 63, 0, 40, 5, 4, "fake", "fake", 20, (Warned("A", "b", "c"),), "3-7-ab", ""),
        level=ServiceLevel(KEY, ServiceTier.FULL, 4),
        answers=(Outcome(KEY, 3, Code.OK, 80), Outcome(KEY, 5, Code.NOT_FOUND, None, "UNKNOWN_PROMPT", "prompt 8")),
        reached=(ConstraintReached(KEY, 1, True, 60, 1, Deviation(0.1, 0.1), None, None),),
        warnings={4: (Warned("A", "b", "c"),)},
        attempt=2,
        snapshot=snapshot,
    )


if __name__ == "__main__":
    record = write_record(a_record())
    (RECORDS / f"{record[5:21].decode()}.bin").write_bytes(record)
