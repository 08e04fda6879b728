"""Generates the takes of the gallery through a server, as any client does."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from motiongen_client.client import MotionClient
from motiongen_client.errors import EventRefused, InvalidInput
from motiongen_client.motion import Float32, Motion, Rig
from motiongen_client.prompts import Preset
from motiongen_client.types import (
    Clip,
    Constraint,
    HeadingTarget,
    JointTargets,
    Keyframe,
    Model,
    RootPath,
    RootTrajectory,
    SessionOptions,
    Waypoint,
)
from motiongen_tools.gallery.animation import Animation, Goal, feet_of, refused
from motiongen_tools.gallery.questions import STAND, Poses, Question, questions_of

AT_ONCE = 4  # clips that a server works on at the same time
GESTURE = "raise-both"
STANDS_ON_M = 0.01


@dataclass(frozen=True)
class Asked:
    """One question and its result, as the page reads it."""

    question: Question
    shown: dict[str, Any]


async def ask_all(client: MotionClient, model: Model, steps: int | None, seed: int) -> list[Asked]:
    """Ask a model all questions. Questions about joints that its rig does not have are left out."""
    rig = client.catalog.rig(model.rig_id)
    options = SessionOptions(model_id=model.model_id, seed=seed, denoise_steps=steps)
    poses = await _poses(client, model, rig, options)
    turn = asyncio.Semaphore(AT_ONCE)

    async def ask(question: Question) -> Asked | None:
        constraints = question.targets(poses)
        if constraints is None:
            return None
        async with turn:
            shown = await _ask(client, rig, options, question, constraints)
        return Asked(question, shown)

    answers = await asyncio.gather(*(ask(question) for question in questions_of(model)))
    return [each for each in answers if each is not None]


async def _poses(client: MotionClient, model: Model, rig: Rig, options: SessionOptions) -> Poses:
    """Poses that the model reaches after two seconds. If it lacks the usual gesture, its last preset is used."""
    count = rig.frames_in(2) + 1
    presets = list(model.presets)
    gesture = GESTURE if GESTURE in presets else (presets[-1] if presets else None)
    last = []
    for prompt in (STAND, STAND if gesture is None else Preset(gesture)):
        (clip,) = await client.generate_clip(prompt, num_frames=count, options=options)
        pose = clip.motion.joint_positions_m()[-1]
        last.append((pose - pose[0] * np.array([1, 0, 1], np.float32)).astype(np.float32))
    return Poses(rig, last[0], last[1])


async def _ask(
    client: MotionClient, rig: Rig, options: SessionOptions, question: Question, constraints: list[Constraint]
) -> dict[str, Any]:
    later = {rig.frames_in(at_s): prompt for at_s, prompt in question.later.items()}
    try:
        (clip,) = await client.generate_clip(
            question.prompt, num_frames=rig.frames_in(question.seconds), later_prompts=later, options=options,
            constraints=constraints,
        )  # fmt: skip
    except (EventRefused, InvalidInput) as refusal:
        return refused(str(refusal))
    return animation_of(clip, constraints).shown()


def animation_of(clip: Clip, constraints: list[Constraint]) -> Animation:
    """A clip with its goals and how near it came to them."""
    motion = clip.motion
    names = motion.rig.joint_names
    return Animation(
        motion.joint_positions_m(), motion.foot_contact > 0.5, feet_of(names), motion.rig.parents, names,
        motion.rig.frame_rate_hz, tuple(_goal(each, motion) for each in constraints), *_verdict(clip),
    )  # fmt: skip


def _verdict(clip: Clip) -> tuple[str, str]:
    """A clip's verdict: the text below its picture, and whether everything asked for was met."""
    told = [warning.message for warning in clip.warnings]
    for residual in clip.residuals:
        errors = []
        if residual.position_m is not None:
            errors.append(f"{100 * residual.position_m.worst:.1f} cm off")
        for angle in (residual.heading_rad, residual.rotation_rad):
            if angle is not None:
                errors.append(f"{math.degrees(angle.worst):.0f}° off")
        told.append(f"{'met' if residual.met else 'missed'}: {', '.join(errors) or 'nothing to measure'}")
    if not clip.residuals:
        return "; ".join(told), ""
    return "; ".join(told), "met" if all(residual.met for residual in clip.residuals) else "missed"


def _goal(constraint: Constraint, motion: Motion) -> Goal:
    match constraint:
        case Waypoint(frame=frame, x_m=x, z_m=z):
            return Goal(frame, _ground([[x, z]]))
        case RootTrajectory(positions_m=places):
            return Goal(None, _ground(places), is_path=True)
        case RootPath(corners_m=corners):
            return Goal(None, _ground([motion.root_translation_m[0, [0, 2]], *corners]), is_path=True)
        case Keyframe(frame=frame, positions_m=places) | JointTargets(frame=frame, positions_m=places):
            return Goal(frame, np.asarray(places, np.float32))
        case HeadingTarget(frame=frame, heading_rad=heading):
            # a point one metre away in the direction that it should face
            x, _, z = motion.root_translation_m[min(frame, len(motion) - 1)]
            away = [x + math.sin(heading), z + math.cos(heading)]
            return Goal(frame, _ground([[x, z], away]), is_path=True)
    raise InvalidInput("constraint", type(constraint).__name__, "a kind that the gallery draws")


def _ground(places: Any) -> Float32:
    flat = np.asarray(places, np.float32).reshape(-1, 2)
    return np.insert(flat, 1, STANDS_ON_M, axis=1)
