"""Adherence to prompts: turning the labelled way, walking straight again, waving with one hand; and reconstruction."""

from __future__ import annotations

import math

import torch

from motiongen_ardy.evaluate.cases import MOVING, STANDING
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.figure import Sample, summarize
from motiongen_ardy.evaluate.measures.root import turned
from motiongen_ardy.evaluate.rows.velocity import WALK
from motiongen_ardy.evaluate.sampler import result_of
from motiongen_ardy.evaluate.take import Result, Take

FAMILY = "text"
ENOUGH_DEG = 45


def add(context: Context) -> None:
    """Add all rows about prompts."""
    _turns(context)
    _gestures(context)
    _reconstruction(context)


def net_turn(context: Context, result: Result, first: int, end: int | None = None) -> float:
    """Degrees by which the hips turn from frame `first` on, + to the left."""
    heading = result.facing(context.skeleton)[first:end]
    return math.degrees(float(turned(heading[1:], heading[:-1]).sum()))


def _turns(context: Context) -> None:
    """A walk, 4 s of a prompt that turns, and a straight walk again."""
    begin, end = context.frames(2), context.frames(6)
    takes = [
        Take(side, seed, context.frames(9), ((0, WALK), (begin, f"a person turns {side} while walking"), (end, WALK)))
        for side in ("left", "right")
        for seed in range(context.size.sessions)
    ]
    results = context.run(takes)

    def right_way(result: Result) -> float:
        sign = 1 if result.take.case == "left" else -1
        return float(sign * net_turn(context, result, begin, end) > ENOUGH_DEG)

    def after(result: Result) -> float:
        return abs(net_turn(context, result, end + context.fps)) / 2

    row = f"turns the labelled way by {ENOUGH_DEG} degrees or more"
    context.add_goal(FAMILY, row, "share", results, right_way, more_is_better=True)
    row = "walks straight from 1 s after the turn's prompt: turn"
    context.add_goal(FAMILY, row, "degrees/s", results, after, first=end)
    title = "turn left from 2 s to 6 s"
    context.show(FAMILY, [Exhibit(f"{title}: {net_turn(context, results[0], begin, end):.0f} degrees", results[0])])


def _gestures(context: Context) -> None:
    """Waving with one hand and not the other, 4 s from nothing; walks that cover 2 m."""
    skeleton = context.skeleton
    hands = {"right": skeleton.right_hand[0], "left": skeleton.left_hand[0]}
    takes = [
        Take(side, seed, context.frames(4), ((0, f"a person waves with the {side} hand"),))
        for side in hands
        for seed in range(context.size.sessions)
    ]
    walks = [Take("walk", seed, context.frames(4), ((0, WALK),)) for seed in range(context.size.sessions)]
    results = context.run([*takes, *walks])

    def raised(result: Result, side: str) -> bool:
        hand = hands[side]
        shoulder = skeleton.parents[skeleton.parents[hand]]
        above = result.positions[:, hand, 1] > result.positions[:, shoulder, 1]
        return int(above.sum()) >= context.fps // 4

    def waves(result: Result) -> float:
        side = result.take.case
        return float(raised(result, side) and not raised(result, "left" if side == "right" else "right"))

    row = "waves with the named hand and no other"
    context.add_goal(FAMILY, row, "share", results[: len(takes)], waves, more_is_better=True)
    row = "walks 2 m or more in 4 s"
    far = results[len(takes) :]
    context.add_goal(
        FAMILY, row, "share", far, lambda one: float((one.root[-1] - one.root[0]).norm() >= 2), more_is_better=True
    )


@torch.no_grad()
def _reconstruction(context: Context) -> None:
    """Joint error of clips that are encoded and decoded without denoising, 6 s of each at most."""
    layout, codec, patch = context.layout, context.sampler.model.codec, context.sampler.model.config.patch
    for group in (MOVING, STANDING):
        samples = []
        for case in context.chosen(group, 16, 60):
            length = min(case.num_frames, 6 * context.fps) // patch * patch
            frames = case.features[None, :length]
            tokens = codec.to_hybrid(layout.normalize(frames))
            decoded = layout.denormalize(codec.from_hybrid(tokens, torch.tensor([length])))[0]
            done = result_of(layout, case.motion.take, decoded)
            error = (done.positions - case.motion.positions[:length]).norm(dim=-1).mean()
            samples.append(Sample(case.id, float(error)))
        bound = context.bound("reconstruction", group)
        context.add(summarize(("tokenizer", "reconstruction", group), "m", samples, bound=bound))
