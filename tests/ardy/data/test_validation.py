"""The validation split: always the same, taken from the train split only, and closed under derivation."""

from __future__ import annotations

from motiongen_ardy.data.validation import is_validation, origins, with_validation

IDS = [f"clip_{number:04d}" for number in range(2000)]


def test_about_one_train_clip_in_25_is_always_held_out_for_validation() -> None:
    splits = dict.fromkeys(IDS, "train")
    cut = with_validation(splits, {})
    count = sum(split == "validation" for split in cut.values())
    assert 50 <= count <= 115
    assert cut == with_validation(dict(reversed(splits.items())), {})


def test_clips_of_the_test_split_stay_in_it() -> None:
    assert set(with_validation(dict.fromkeys(IDS, "test"), {}).values()) == {"test"}


def test_derived_clips_are_validation_if_any_source_is() -> None:
    held = next(one for one in IDS if is_validation([one]))
    free = next(one for one in IDS if not is_validation([one]))
    derived_from = {"a": held, "b": "a", "c": free, "d": f"{free}+b", held: "", free: ""}
    cut = with_validation(dict.fromkeys([held, free, "a", "b", "c", "d"], "train"), derived_from)
    assert cut == {
        held: "validation",
        free: "train",
        "a": "validation",
        "b": "validation",
        "c": "train",
        "d": "validation",
    }


def test_pieces_of_a_capture_stay_together() -> None:
    held = next(one for one in IDS if is_validation([one]))
    free = next(one for one in IDS if not is_validation([one]))
    pieces = {one: [f"{one}~cut{number}" for number in range(1, 100)] for one in (held, free)}
    made = {f"{piece}~start1": piece for piece in pieces[held]}
    cut = with_validation(dict.fromkeys([*pieces[held], *pieces[free], *made], "train"), made)
    assert {cut[piece] for piece in (*pieces[held], *made)} == {"validation"}
    assert {cut[piece] for piece in pieces[free]} == {"train"}


def test_circular_derivations_end() -> None:
    assert origins("a", {"a": "b", "b": "a"}) == []
