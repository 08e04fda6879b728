"""Any message at all is either accepted with finite numbers or refused."""

from __future__ import annotations

import contextlib
import math

from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import (
    Code,
    Event,
    JointTargets,
    Open,
    Playhead,
    RootTrajectory,
    SetConstraints,
    SetVelocity,
    Waypoint,
)
from motiongen_server.errors import EventRefused
from tests.server.engine.fakes import FACTS
from tests.server.rpc.convert.conversion import KEY, attempt

numbers = st.floats(width=32)


lists = st.lists(numbers, max_size=14)


uint32 = st.integers(0, 2**32 - 1)


uint64 = st.one_of(st.integers(0, 200), st.integers(0, 2**64 - 1))


enums = st.integers(-3, 12)


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)


roots = st.builds(motion_pb2.Waypoint, x=numbers, z=numbers, heading=st.none() | numbers)


starts = st.builds(session_pb2.StartPose, x=numbers, z=numbers, heading=st.none() | numbers)


spans = st.builds(motion_pb2.PromptSpan, prompt_id=st.integers(0, 3), start_frame=uint64, end_frame=uint64, text=texts)


targets = st.one_of(
    st.fixed_dictionaries({}),
    st.fixed_dictionaries({"waypoint": roots}),
    st.fixed_dictionaries(
        {
            "joint_targets": st.builds(
                motion_pb2.JointTargets,
                joints=st.lists(st.integers(0, 2), max_size=3),
                positions=lists,
                rotations=lists,
            )
        }
    ),
    st.fixed_dictionaries({"keyframe": st.builds(motion_pb2.Keyframe, positions=lists)}),
    st.fixed_dictionaries({"root_trajectory": st.builds(motion_pb2.RootTrajectory, positions=lists, headings=lists)}),
)


constraints = st.builds(
    lambda constraint_id, frame, target: motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, **target),
    st.integers(0, 3),
    uint64,
    targets,
)


opens = st.builds(
    session_pb2.OpenSession,
    request_id=texts,
    rig_id=st.sampled_from(["", FACTS.rig.rig_id, "other"]),
    model_id=st.sampled_from(["", FACTS.model_id, "other"]),
    seed=st.none() | st.integers(0, 2**64 - 1),
    priority=enums,
    lookahead_frames=st.one_of(st.just(0), st.integers(30, 90), uint32),
    scalar_type=enums,
    prompts=st.lists(spans, max_size=3),
    constraints=st.lists(constraints, max_size=3),
    start_pose=st.none() | starts,
    denoise_steps=st.none() | st.integers(0, 12),
    guidance=st.none() | st.builds(session_pb2.Guidance, text=st.none() | numbers, constraint=st.none() | numbers),
)


prompt_edits = st.builds(
    session_pb2.EditPrompts, upsert=st.lists(spans, max_size=18), remove=st.lists(uint32, max_size=3)
)


constraint_edits = st.builds(
    session_pb2.EditConstraints,
    upsert=st.lists(constraints, max_size=4),
    remove=st.lists(uint32, max_size=3),
    clear=st.booleans(),
)


playheads = st.builds(session_pb2.Playhead, frame=uint64, buffered_to=uint64, underruns=uint32)


states = st.builds(session_pb2.SetPlayState, state=enums)


velocities = st.builds(
    session_pb2.SetVelocity, x=numbers, z=numbers, heading=st.none() | numbers, hold_frames=st.integers(0, 500)
)


members = st.one_of(
    st.fixed_dictionaries({}),
    st.fixed_dictionaries({"open": opens}),
    st.fixed_dictionaries({"edit_prompts": prompt_edits}),
    st.fixed_dictionaries({"edit_constraints": constraint_edits}),
    st.fixed_dictionaries({"playhead": playheads}),
    st.fixed_dictionaries({"set_velocity": velocities}),
    st.fixed_dictionaries({"set_play_state": states}),
    st.fixed_dictionaries({"close": st.just(session_pb2.CloseSession())}),
)


def numbers_of(event: Event) -> list[float]:
    """Every coordinate, heading and weight that reaches the engine."""
    found: list[float] = []
    if isinstance(event, Open):
        pose, guidance = event.spec.start_pose, event.spec.guidance
        found += [pose.x, pose.z, pose.heading, guidance.text, guidance.constraint]
    if isinstance(event, SetVelocity):
        found += [event.x, event.z, event.heading or 0.0]
    held = event.spec.constraints if isinstance(event, Open) else ()
    if isinstance(event, SetConstraints):
        held = event.upsert
    for item in held:
        if isinstance(item, Waypoint):
            found += [item.x, item.z, item.heading or 0.0]
        elif isinstance(item, RootTrajectory):
            found += [*item.xz.ravel(), *(() if item.heading is None else item.heading)]
        else:
            found += item.positions.ravel().tolist()
            if isinstance(item, JointTargets) and item.rotations is not None:
                found += item.rotations.ravel().tolist()
    return found


@settings(deadline=None)
@given(members)
def test_any_event_is_accepted_with_finite_numbers_or_refused_with_details(members: dict[str, object]) -> None:
    message = session_pb2.SessionEvent(session=KEY.handle, event_seq=4, **members)  # type: ignore[arg-type]
    answer = attempt(message)
    if isinstance(answer, EventRefused):
        assert answer.code is not Code.OK
        assert answer.reason.isupper()
        assert answer.field
        assert answer.allowed
    else:
        assert answer.session == KEY
        assert (answer.event_seq, answer.received_at) == (0 if isinstance(answer, Playhead) else 4, 12.5)
        assert all(math.isfinite(number) for number in numbers_of(answer))


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_random_bytes_are_accepted_or_refused(data: bytes) -> None:
    message = session_pb2.SessionEvent()
    with contextlib.suppress(DecodeError):  # what was parsed before the error is a message too
        message.ParseFromString(data)
    attempt(message)
