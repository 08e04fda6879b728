"""Derived clips: their sources and labels, the frames of their captions, and the reasons to drop one."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.data.build import cut, more_labels
from motiongen_ardy.data.captions import mirror_content, paraphrases
from motiongen_ardy.data.dataset import Clip, MotionDataset
from motiongen_ardy.data.derive import turning_spans
from motiongen_ardy.data.derived_phrases import PLAIN, SIDED
from motiongen_ardy.data.kinds import by_kind
from motiongen_ardy.data.poses import global_pose
from motiongen_ardy.data.quality import quality
from motiongen_ardy.data.recipes import RECIPES, fault, make
from motiongen_ardy.data.replant import Replanted
from motiongen_ardy.data.shelf import Made, Shelf, Unfit
from motiongen_ardy.data.warp import warp
from tests.ardy.data.walker import CORE, FPS, clip, standing, walking


def captures(style: str = "normal") -> list[Clip]:
    walks = [clip(walking(140 + 10 * n, 0.9 + 0.1 * n), "walk", n, style) for n in range(3)]
    runs = [clip(walking(120, 1.5), "run", 9, style)]
    still = [clip(standing(100), "stand", 1, style), clip(standing(90), "raise-up-left-hand", 1, style)]
    return [*walks, *runs, *still]


@pytest.mark.parametrize("kind", sorted(RECIPES))
def test_every_recipe_makes_clips_with_ordered_captioned_spans(kind: str) -> None:
    shelf = Shelf(CORE, FPS, captures(), np.random.default_rng(3))
    made = [entry for entry in (attempt(kind, shelf) for _ in range(20)) if entry is not None]
    assert len(made) >= 3
    for entry in made:
        starts = [span[0] for span in entry.spans]
        assert starts[0] == 0
        assert starts == sorted(starts)
        assert all(paraphrases(content, style) for _, content, style in entry.spans)


def attempt(kind: str, shelf: Shelf) -> Made | None:
    try:
        return RECIPES[kind][0](shelf)
    except Unfit:
        return None


def test_a_seed_determines_the_clips_which_name_their_sources() -> None:
    clips = captures()
    made, _ = make(clips, CORE, FPS, 5, 0.004)
    again, _ = make(clips, CORE, FPS, 5, 0.004)
    assert made
    assert [entry.id for entry in made] == [entry.id for entry in again]
    assert all(torch.equal(a.root_positions, b.root_positions) for a, b in zip(made, again, strict=True))
    ids = {entry.id for entry in clips}
    assert any("+" in entry.derived_from for entry in made), "a start is derived from a walk and a stand"
    for entry in made:
        sources = entry.derived_from.split("+")
        assert set(sources) <= ids
        assert len(set(sources)) == len(sources)
        assert entry.id.startswith(sources[0])
        assert any(flag.startswith("derived-") for flag in entry.flags)
        if entry.segments:
            assert sum(part.length for part in entry.segments) == entry.num_frames
            assert entry.segments[0].start == 0


@pytest.mark.parametrize("dataset", ["", "mine", "dataset-1"])
def test_captures_of_any_dataset_are_put_on_the_shelf(dataset: str) -> None:
    named = [dataclasses.replace(entry, dataset=dataset) for entry in captures()]
    shelf = Shelf(CORE, FPS, named, np.random.default_rng(0))
    assert [len(kind) for kind in (shelf.walks, shelf.runs, shelf.gestures, shelf.stands)] == [3, 1, 1, 1]


def test_captures_known_to_be_unfit_are_not_put_on_the_shelf() -> None:
    walk = captures()[0]
    unfit = [dataclasses.replace(walk, dataset="cmu"), dataclasses.replace(walk, flags=("uneven_ground",))]
    assert Shelf(CORE, FPS, unfit, np.random.default_rng(0)).walks == []


def test_a_label_without_phrases_makes_no_clip_and_is_counted() -> None:
    named = [dataclasses.replace(entry, content="raise-up-a-flag") for entry in captures()[-1:]]
    made, dropped = make([*captures()[:-1], *named], CORE, FPS, 5, 0.01)
    assert dropped["transition: no phrases"]
    assert all(entry.captions and all(part.captions for part in entry.segments) for entry in made)
    assert not any("flag" in entry.content for entry in made)


def test_walks_in_the_held_out_style_turn_only_right() -> None:
    made, _ = make(captures("exhausted"), CORE, FPS, 5, 0.01)
    turning = [entry for entry in made if mirror_content(entry.content) != entry.content and "strafe" not in entry.id]
    gestures = ("raise-up", "wave")
    turning = [entry for entry in turning if not entry.content.startswith(gestures)]
    assert turning
    assert all(entry.content.endswith("right") and not entry.mirror_allowed for entry in turning)


def test_a_clip_whose_feet_slide_is_dropped() -> None:
    walk = captures()[0]
    shelf = Shelf(CORE, FPS, captures(), np.random.default_rng(0))
    poses = shelf.poses(walk)
    good = Made("bend", (walk,), "walk", "normal", Replanted(poses, np.zeros(1), np.zeros(1)), ((0, "walk", "normal"),))
    assert fault(good, quality(CORE, poses.quaternions, poses.root, FPS), CORE) == ""
    slid = poses.root + np.arange(poses.num_frames)[:, None] * np.array([0.0, 0.0, 0.03])
    assert fault(good, quality(CORE, poses.quaternions, slid, FPS), CORE) == "slowest_ratio"


def test_only_the_turning_frames_of_a_walk_are_labelled_as_a_turn() -> None:
    walk = walking(120)
    turn = math.pi / 2 * np.clip((np.arange(120) - 50) / 20, 0, 1)
    made = warp(CORE, walk, FPS, turn, travel=turn, stride=np.ones(120)).poses
    positions = torch.from_numpy(global_pose(CORE, made.quaternions, made.root)[1])
    spans = turning_spans(CORE, "walk-turn-left", positions, FPS)
    assert [span.content for span in spans] == ["walk", "walk-turn-left", "walk"]
    assert 40 <= spans[1].start <= 52
    assert 66 <= spans[2].start <= 82
    assert sum(span.length for span in spans) == 120
    assert turning_spans(CORE, "walk-turn-right", positions, FPS) == []


def test_a_long_clip_is_cut_into_equal_pieces() -> None:
    pieces = list(cut(clip(standing(95), "idle", 1), 40))
    assert [piece.num_frames for piece in pieces] == [31, 32, 32]
    assert len({piece.id for piece in pieces}) == 3
    whole = dataclasses.replace(pieces[0], root_positions=torch.cat([piece.root_positions for piece in pieces]))
    assert whole.num_frames == 95


def test_rows_of_the_package_are_added_only_for_existing_files(tmp_path: Path) -> None:
    assert more_labels(tmp_path) == ()
    (tmp_path / "cmu-131").mkdir()
    (tmp_path / "cmu-131" / "131_02.bvh").write_text("")
    assert [label.id for label in more_labels(tmp_path)] == ["cmu-131_02"]


def test_every_derived_content_has_captions_and_a_mirror_image() -> None:
    for content in (*PLAIN, *(slug.format(side=side) for slug in SIDED for side in ("left", "right"))):
        assert paraphrases(content, "normal")
        assert paraphrases(mirror_content(content), "tired")


def test_figures_are_grouped_by_how_a_clip_was_made() -> None:
    clips = captures()
    made, _ = make(clips, CORE, FPS, 5, 0.002)
    kinds = by_kind(MotionDataset(CORE, FPS, (*clips, *made)))
    assert sum(map(len, kinds.values())) == len(clips) + len(made)
    assert {"walk", "run", "derived: strafe"} <= set(kinds)
    assert all(figures.slowest_ratio < 0.1 for _, figures in kinds["derived: strafe"])
