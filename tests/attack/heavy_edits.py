"""Hostile edits that take much longer than others of the same size; see `tests.attack.hostile`."""

from __future__ import annotations

from collections.abc import Sequence

from motiongen.v1 import motion_pb2, session_pb2
from tests.attack.calls import Event, Request, flood

SESSIONS = 32
MOST = 256
"""Constraints in an edit."""


def _opens() -> bytes:
    opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(SESSIONS)]
    return Request(events=opens).SerializeToString()


async def _edit(address: str, constraints: Sequence[motion_pb2.Constraint]) -> None:
    edit = session_pb2.EditConstraints(upsert=constraints)
    numbered = ((n, number) for number in range(2, 40) for n in range(SESSIONS))
    edits = [Event(session=n, event_seq=number, edit_constraints=edit) for n, number in numbered]
    await flood(address, [_opens(), *(Request(events=[event]).SerializeToString() for event in edits)])


async def long_paths(address: str) -> None:
    """Edits of 256 paths each, where every path is a walk of nine minutes in a few bytes."""
    path = motion_pb2.RootPath(positions=[0.0, 600.0], speed_mps=1.2)
    await _edit(address, [motion_pb2.Constraint(constraint_id=number, root_path=path) for number in range(1, MOST + 1)])


def _rotations(numbers: Sequence[int]) -> list[motion_pb2.Constraint]:
    """Rotations that leave their frames open, so that the engine has to place each."""
    turn = motion_pb2.JointRotations(joints=[3], rotations=[1.0, 0.0, 0.0, 0.0])
    return [motion_pb2.Constraint(constraint_id=number, at_any_frame=True, joint_rotations=turn) for number in numbers]


async def many_rotations(address: str) -> None:
    """Edits of 256 rotations each, which are slow to convert and to place."""
    await _edit(address, _rotations(range(1, MOST + 1)))


async def refused_rotations(address: str) -> None:
    """Opens with as many, of which the last is invalid: all others are converted first, and no session pays for it."""
    opening = session_pb2.OpenSession(constraints=_rotations([*range(1, MOST), 0]))
    opens = [Event(session=n, event_seq=1, open=opening) for n in range(SESSIONS)]
    await flood(address, [Request(events=[event]).SerializeToString() for event in opens])
