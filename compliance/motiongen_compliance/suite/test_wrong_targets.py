"""Targets and velocities with a wrong frame, speed or weight: the answer names the field, and nothing changes."""

from __future__ import annotations

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_compliance.messages import edit_constraints
from motiongen_compliance.mistakes import INF, NAN, Catalog, Event, Mistake, Status, refuse_all
from motiongen_compliance.target import Scene

TARGET = "edit_constraints.upsert[0]"
PATH = f"{TARGET}.root_path"


def there(**when: object) -> Event:
    """A waypoint with these frames and this weight."""
    place = motion_pb2.Waypoint(x=1.0)
    return edit_constraints(motion_pb2.Constraint(constraint_id=1, waypoint=place, **when))  # type: ignore[arg-type]


def led(num_frames: int, **when: object) -> Event:
    ground = motion_pb2.RootTrajectory(positions=[0.0] * (2 * num_frames))
    return edit_constraints(motion_pb2.Constraint(constraint_id=1, root_trajectory=ground, **when))  # type: ignore[arg-type]


def path(positions: list[float], frame: int = 0, **how: float) -> Event:
    way = motion_pb2.RootPath(positions=positions, **how)
    return edit_constraints(motion_pb2.Constraint(constraint_id=1, frame=frame, root_path=way))


def beside(**when: object) -> Event:
    """A path with frames, which paths must not have."""
    way = motion_pb2.RootPath(positions=[0.0, 2.0])
    return edit_constraints(motion_pb2.Constraint(constraint_id=1, root_path=way, **when))  # type: ignore[arg-type]


def velocity(**fields: float) -> Event:
    return Event(set_velocity=session_pb2.SetVelocity(**fields))  # type: ignore[arg-type]


def many_trajectories(catalog: Catalog) -> Event:
    """More trajectory frames than a session may hold, although no single trajectory is too long."""
    longest = catalog.limits.max_trajectory_frames
    count = catalog.limits.max_held_trajectory_frames // longest + 1
    ground = motion_pb2.RootTrajectory(positions=[0.0] * (2 * longest))
    return edit_constraints(
        *(motion_pb2.Constraint(constraint_id=n + 1, frame=900, root_trajectory=ground) for n in range(count))
    )


FRAMES = [
    Mistake("end before begin", lambda c: there(frame=90, last_frame=89), "EMPTY_SPAN", f"{TARGET}.last_frame"),
    Mistake(
        "end frame too large",
        lambda c: there(frame=90, last_frame=2**53 + 1),
        "FRAME_OUT_OF_RANGE",
        f"{TARGET}.last_frame",
    ),
    Mistake(
        "any frame and a last frame",
        lambda c: there(at_any_frame=True, last_frame=90),
        "AMBIGUOUS_FRAMES",
        f"{TARGET}.at_any_frame",
    ),
    Mistake(
        "any frame and a frame", lambda c: there(at_any_frame=True, frame=90), "AMBIGUOUS_FRAMES", f"{TARGET}.frame"
    ),
    Mistake(
        "trajectory at any frame", lambda c: led(4, at_any_frame=True), "AMBIGUOUS_FRAMES", f"{TARGET}.at_any_frame"
    ),
    Mistake(
        "trajectory with a last frame",
        lambda c: led(4, frame=90, last_frame=95),
        "AMBIGUOUS_FRAMES",
        f"{TARGET}.last_frame",
    ),
    Mistake("trajectory frame too large", lambda c: led(4, frame=2**53), "FRAME_OUT_OF_RANGE", f"{TARGET}.frame"),
    Mistake("path at a frame", lambda c: beside(frame=90), "AMBIGUOUS_FRAMES", f"{TARGET}.frame"),
    Mistake("path with a last frame", lambda c: beside(last_frame=90), "AMBIGUOUS_FRAMES", f"{TARGET}.last_frame"),
]

WEIGHTS = [
    Mistake("weight 0", lambda c: there(frame=900, weight=0.0), "WEIGHT_OUT_OF_RANGE", f"{TARGET}.weight"),
    Mistake("negative weight", lambda c: there(frame=900, weight=-1.0), "WEIGHT_OUT_OF_RANGE", f"{TARGET}.weight"),
    Mistake("weight too large", lambda c: there(frame=900, weight=10.1), "WEIGHT_OUT_OF_RANGE", f"{TARGET}.weight"),
    Mistake("NaN weight", lambda c: there(frame=900, weight=NAN), "NOT_FINITE", f"{TARGET}.weight"),
]

PATHS = [
    Mistake("path without corners", lambda c: path([]), "WRONG_LENGTH", f"{PATH}.positions"),
    Mistake("odd number of coordinates", lambda c: path([1.0, 2.0, 3.0]), "WRONG_LENGTH", f"{PATH}.positions"),
    Mistake("too many corners", lambda c: path([1.0] * (2 * 257)), "WRONG_LENGTH", f"{PATH}.positions"),
    Mistake("NaN corner", lambda c: path([0.0, NAN]), "NOT_FINITE", f"{PATH}.positions"),
    Mistake(
        "corner out of range",
        lambda c: path([0.0, 2 * c.limits.max_coordinate_m]),
        "COORDINATE_OUT_OF_RANGE",
        f"{PATH}.positions",
    ),
    Mistake("speed 0", lambda c: path([0.0, 2.0], speed_mps=0.0), "SPEED_OUT_OF_RANGE", f"{PATH}.speed_mps"),
    Mistake(
        "speed too large",
        lambda c: path([0.0, 2.0], speed_mps=1.01 * c.limits.max_speed_mps),
        "SPEED_OUT_OF_RANGE",
        f"{PATH}.speed_mps",
    ),
    Mistake("NaN speed", lambda c: path([0.0, 2.0], speed_mps=NAN), "NOT_FINITE", f"{PATH}.speed_mps"),
    Mistake(
        "smoothing too large",
        lambda c: path([0.0, 2.0], smoothing_m=10.1),
        "SMOOTHING_OUT_OF_RANGE",
        f"{PATH}.smoothing_m",
    ),
    Mistake(
        "negative smoothing",
        lambda c: path([0.0, 2.0], smoothing_m=-0.1),
        "SMOOTHING_OUT_OF_RANGE",
        f"{PATH}.smoothing_m",
    ),
    Mistake("path too long", lambda c: path([0.0, 5000.0], speed_mps=1.0), "PATH_TOO_LONG", PATH),
]

VELOCITIES = [
    Mistake(
        "too fast", lambda c: velocity(x=1.01 * c.limits.max_speed_mps, hold_frames=1), "SPEED_OUT_OF_RANGE",
        "set_velocity",
    ),
    Mistake("NaN x", lambda c: velocity(x=NAN, hold_frames=1), "NOT_FINITE", "set_velocity.x"),
    Mistake("infinite z", lambda c: velocity(z=INF, hold_frames=1), "NOT_FINITE", "set_velocity.z"),
    Mistake("NaN heading", lambda c: velocity(heading=NAN, hold_frames=1), "NOT_FINITE", "set_velocity.heading"),
    Mistake("hold of 0 frames", lambda c: velocity(x=1.0), "HOLD_OUT_OF_RANGE", "set_velocity.hold_frames"),
    Mistake(
        "hold too long",
        lambda c: velocity(x=1.0, hold_frames=c.limits.max_hold_frames + 1),
        "HOLD_OUT_OF_RANGE",
        "set_velocity.hold_frames",
    ),
]  # fmt: skip


async def test_contradictory_frames_are_refused(scene: Scene) -> None:
    await refuse_all(scene, FRAMES)


async def test_weights_out_of_range_are_refused(scene: Scene) -> None:
    await refuse_all(scene, WEIGHTS)


async def test_invalid_paths_are_refused(scene: Scene) -> None:
    await refuse_all(scene, PATHS)


async def test_invalid_velocities_are_refused(scene: Scene) -> None:
    await refuse_all(scene, VELOCITIES)


async def test_trajectories_too_long_in_total_are_refused(scene: Scene) -> None:
    if not scene.talk.catalog.limits.max_held_trajectory_frames:  # this server has no such limit
        return
    outcome = await scene.talk.edit(1, many_trajectories(scene.talk.catalog))
    if outcome.reason != "UNSUPPORTED_CONSTRAINT":
        told = (outcome.code, outcome.reason, bool(outcome.allowed))
        assert told == (Status.RESOURCE_EXHAUSTED.value[0], "TOO_MANY_TRAJECTORY_FRAMES", True)
    await scene.talk.plays_on(1)
    await scene.others_play_on()


async def test_velocities_are_accepted_and_named_by_their_plans(scene: Scene) -> None:
    talk, heard = scene.talk, scene.talk.sessions[1]
    for event in (
        velocity(z=1.0, hold_frames=40),
        velocity(hold_frames=40),
        velocity(x=0.5, heading=9.0, hold_frames=1),
    ):
        outcome = await talk.edit(1, event)
        if outcome.reason == "UNSUPPORTED_CONSTRAINT":
            continue
        assert outcome.code == 0, outcome
        if outcome.HasField("effective_frame"):
            plan = next(plan for plan in heard.plans if outcome.event_seq in plan.event_seqs)
            assert plan.valid_from <= outcome.effective_frame
        await talk.plays_on(1)
    await scene.others_play_on()
