"""Invalid prompts, options, cuts and opens: the answer names the field, and nothing changes."""

from __future__ import annotations

import struct

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_compliance.messages import addressed, edit_prompts, span
from motiongen_compliance.mistakes import INF, NAN, Catalog, Event, Mistake, Status, check, opening, refuse_all
from motiongen_compliance.talk import rig_of
from motiongen_compliance.target import Scene

PROMPT = "edit_prompts.upsert[0]"


def encoded(catalog: Catalog, number: float = 0.0, missing: int = 0, **fields: str) -> motion_pb2.TextEmbedding:
    model = catalog.models[0]
    values = [number] * (model.text_width - missing)
    return motion_pb2.TextEmbedding(text_encoder=fields.get("encoder", model.text_encoder), values=values)


def prompt(**fields: object) -> Event:
    return edit_prompts(motion_pb2.PromptSpan(prompt_id=1, **fields))  # type: ignore[arg-type]


def options(**fields: object) -> Event:
    return Event(set_options=session_pb2.SetOptions(**fields))  # type: ignore[arg-type]


def prior(catalog: Catalog, num_frames: int, length: float = 1.0, **fields: object) -> motion_pb2.FrameChunk:
    """Frames of a character in the neutral pose. length: norm of their quaternions."""
    numbers = {"root_translation_m": [0.0, 1.0, 0.0]}
    row: list[float] = []
    for block in rig_of(catalog).blocks:
        turns = [length, 0.0, 0.0, 0.0] * (block.width // 4)
        row += numbers.get(block.name, turns if "quat_wxyz" in block.name else [0.0] * block.width)
    data = struct.pack(f"<{len(row)}f", *row) * num_frames
    return motion_pb2.FrameChunk(**{"frame_count": num_frames, "data": data} | fields)  # type: ignore[arg-type]


def patch(catalog: Catalog) -> int:
    return catalog.models[0].patch_frames


def cut(**fields: object) -> Event:
    return Event(seek=session_pb2.Seek(**fields))  # type: ignore[arg-type]


NO_ENCODER = Status.FAILED_PRECONDITION
PROMPTS = [
    Mistake(
        "preset and text",
        lambda c: prompt(text="walk", preset_id="walk"),
        "AMBIGUOUS_PROMPT",
        f"{PROMPT}.preset_id",
    ),
    Mistake(
        "preset and embedding",
        lambda c: prompt(embedding=encoded(c), preset_id="walk"),
        "AMBIGUOUS_PROMPT",
        f"{PROMPT}.preset_id",
    ),
    Mistake(
        "unknown preset",
        lambda c: prompt(preset_id="none of this name"),
        "UNKNOWN_PRESET",
        f"{PROMPT}.preset_id",
        code=Status.NOT_FOUND,
    ),
    Mistake(
        "embedding of another encoder",
        lambda c: prompt(embedding=encoded(c, encoder="another")),
        "WRONG_TEXT_ENCODER",
        f"{PROMPT}.embedding.text_encoder",
        code=NO_ENCODER,
    ),
    Mistake(
        "embedding of no encoder",
        lambda c: prompt(embedding=encoded(c, encoder="")),
        "WRONG_TEXT_ENCODER",
        f"{PROMPT}.embedding.text_encoder",
        code=NO_ENCODER,
    ),
    Mistake(
        "embedding too short", lambda c: prompt(embedding=encoded(c, missing=1)), "WRONG_LENGTH",
        f"{PROMPT}.embedding.values",
    ),
    Mistake("NaN embedding", lambda c: prompt(embedding=encoded(c, NAN)), "NOT_FINITE", f"{PROMPT}.embedding.values"),
    Mistake(
        "infinite embedding", lambda c: prompt(embedding=encoded(c, INF)), "NOT_FINITE", f"{PROMPT}.embedding.values"
    ),
    Mistake(
        "huge embedding", lambda c: prompt(embedding=encoded(c, 1.1e4)), "VALUE_OUT_OF_RANGE",
        f"{PROMPT}.embedding.values",
    ),
    Mistake(
        "end frame too large", lambda c: edit_prompts(span(end=2**53 + 1)), "FRAME_OUT_OF_RANGE",
        f"{PROMPT}.end_frame",
    ),
    Mistake(
        "too many prompts",
        lambda c: edit_prompts(*(span("walk", n + 1) for n in range(c.limits.max_prompts + 1))),
        "TOO_MANY_PROMPTS",
        "edit_prompts.upsert",
        code=Status.RESOURCE_EXHAUSTED,
    ),
    Mistake("id 0 removed", lambda c: edit_prompts(remove=[0]), "INVALID_ID", "edit_prompts.remove[0]"),
]  # fmt: skip

OPTIONS = [
    Mistake("invalid class", lambda c: options(priority=9), "INVALID_PRIORITY", "set_options.priority"),
    Mistake(
        "lookahead too short", lambda c: options(lookahead_frames=1), "LOOKAHEAD_OUT_OF_RANGE",
        "set_options.lookahead_frames",
    ),
    Mistake(
        "lookahead too long",
        lambda c: options(lookahead_frames=c.limits.max_lookahead_frames + 1),
        "LOOKAHEAD_OUT_OF_RANGE",
        "set_options.lookahead_frames",
    ),
    Mistake("0 steps", lambda c: options(denoise_steps=0), "DENOISE_STEPS_OUT_OF_RANGE", "set_options.denoise_steps"),
    Mistake(
        "too much history",
        lambda c: options(history_frames=c.models[0].max_history_frames + patch(c)),
        "HISTORY_OUT_OF_RANGE",
        "set_options.history_frames",
    ),
    Mistake(
        "history in part patches", lambda c: options(history_frames=2 * patch(c) - 1), "HISTORY_OUT_OF_RANGE",
        "set_options.history_frames",
    ),
    Mistake(
        "guidance too large",
        lambda c: options(guidance=session_pb2.Guidance(text=1.01 * c.limits.max_guidance)),
        "GUIDANCE_OUT_OF_RANGE",
        "set_options.guidance.text",
    ),
    Mistake(
        "NaN guidance",
        lambda c: options(guidance=session_pb2.Guidance(constraint=NAN)),
        "NOT_FINITE",
        "set_options.guidance.constraint",
    ),
]  # fmt: skip

CUTS = [
    Mistake(
        "frame and pose", lambda c: cut(frame=8, start_pose=session_pb2.StartPose()), "AMBIGUOUS_START", "seek.frame"
    ),
    Mistake(
        "pose and frames",
        lambda c: cut(start_pose=session_pb2.StartPose(), prior_frames=prior(c, patch(c))),
        "AMBIGUOUS_START",
        "seek.start_pose",
    ),
    Mistake("NaN pose", lambda c: cut(start_pose=session_pb2.StartPose(x=NAN)), "NOT_FINITE", "seek.start_pose.x"),
    Mistake("frame too large", lambda c: cut(frame=2**53 + 1), "FRAME_OUT_OF_RANGE", "seek.frame"),
    Mistake(
        "no prior frames", lambda c: cut(prior_frames=prior(c, 0)), "PRIOR_FRAMES_OUT_OF_RANGE",
        "seek.prior_frames.frame_count",
    ),
]  # fmt: skip

OPENINGS = [
    Mistake(
        "prior frames in part patches",
        lambda c: opening(prior_frames=prior(c, 2 * patch(c) - 1)),
        "PRIOR_FRAMES_OUT_OF_RANGE",
        "open.prior_frames.frame_count",
    ),
    Mistake(
        "too many prior frames",
        lambda c: opening(prior_frames=prior(c, (c.limits.max_trajectory_frames // patch(c) + 1) * patch(c))),
        "PRIOR_FRAMES_OUT_OF_RANGE",
        "open.prior_frames.frame_count",
    ),
    Mistake(
        "short rows", lambda c: opening(prior_frames=prior(c, patch(c), data=b"1234")), "WRONG_LENGTH",
        "open.prior_frames.data",
    ),
    Mistake(
        "prior frames of another type",
        lambda c: opening(prior_frames=prior(c, patch(c), scalar_type=motion_pb2.SCALAR_TYPE_F16_LE)),
        "INVALID_SCALAR_TYPE",
        "open.prior_frames.scalar_type",
    ),
    Mistake(
        "prior frames without rotations",
        lambda c: opening(prior_frames=prior(c, patch(c), length=1.1)),
        "NOT_A_ROTATION",
        "open.prior_frames.data",
    ),
    Mistake(
        "NaN rows", lambda c: opening(prior_frames=prior(c, patch(c), length=NAN)), "NOT_FINITE",
        "open.prior_frames.data",
    ),
    Mistake(
        "pose and frames",
        lambda c: opening(start_pose=session_pb2.StartPose(), prior_frames=prior(c, patch(c))),
        "AMBIGUOUS_START",
        "open.start_pose",
    ),
    Mistake(
        "history in part patches", lambda c: opening(history_frames=2 * patch(c) - 1), "HISTORY_OUT_OF_RANGE",
        "open.history_frames",
    ),
    Mistake("snapshot", lambda c: opening(snapshot=b"x"), "NOT_SERVED", "open.snapshot", code=Status.UNIMPLEMENTED),
]  # fmt: skip


async def test_invalid_prompts_are_refused(scene: Scene) -> None:
    await refuse_all(scene, PROMPTS)


async def test_options_out_of_range_are_refused(scene: Scene) -> None:
    await refuse_all(scene, OPTIONS)


async def test_invalid_cuts_are_refused(scene: Scene) -> None:
    await refuse_all(scene, CUTS)


async def test_snapshots_are_refused_as_not_served(scene: Scene) -> None:
    snapshot = Event(take_snapshot=session_pb2.TakeSnapshot())
    await refuse_all(
        scene, [Mistake("snapshot", lambda c: snapshot, "NOT_SERVED", "take_snapshot", code=Status.UNIMPLEMENTED)]
    )


async def test_invalid_opens_are_refused(scene: Scene) -> None:
    talk = scene.talk
    for handle, mistake in enumerate(OPENINGS, 20):
        await talk.send(addressed(mistake.make(talk.catalog), handle, 1))
        await talk.until(lambda handle=handle: handle in talk.sessions and talk.sessions[handle].outcomes)
        check(await talk.answer(handle, 1), mistake)
    await scene.others_play_on()


async def test_open_or_cut_may_continue_from_frames_of_another_session(scene: Scene) -> None:
    talk, num_frames = scene.talk, patch(scene.talk.catalog)
    held = b"".join(talk.sessions[2].frames[frame] for frame in range(num_frames))
    others = motion_pb2.FrameChunk(frame_count=num_frames, data=held)
    await talk.open(3, prior_frames=others)
    await talk.plays_on(3)
    outcome = await talk.edit(1, cut(prior_frames=others))
    assert outcome.code == 0, outcome
    assert outcome.HasField("effective_frame")
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_prompt_may_be_an_embedding_or_a_preset(scene: Scene) -> None:
    talk = scene.talk
    outcome = await talk.edit(1, prompt(embedding=encoded(talk.catalog), text="what the numbers say, for people"))
    assert outcome.code == 0, outcome
    for preset in talk.catalog.models[0].presets[:1]:
        assert (await talk.edit(1, prompt(preset_id=preset.preset_id))).code == 0
    await talk.plays_on(1)
    await scene.others_play_on()
