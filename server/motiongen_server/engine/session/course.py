"""Course: where a character is expected to go during a window, as far as constraints and a lead determine it."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_server.engine.types import Constraint, JointTargets, Keyframe, RootTrajectory, Waypoint

EXPECTED_S = 1.0
"""The longest time for which a character is expected to go straight on."""


class Course:
    """Places of the root by frame: straight lines between them, and standing still after the last.

    A character without any places goes straight on for a while instead, and so does one whose last place is a lead's.
    """

    def __init__(
        self, window: range, fps: int, root: RootState, lead: RootTrajectory | None, constraints: Iterable[Constraint]
    ) -> None:
        """window: the frames it sees. root: the root's state just before. constraints: later ones win."""
        start = window.start
        self._places: dict[int, tuple[float, float]] = {}
        self._most_frames = EXPECTED_S * fps
        self._going = root.speed_x / fps, root.speed_z / fps
        self._window = window
        if lead is not None:
            self._add_path(lead)
        self._led_to = max(self._places, default=start - 1)
        if len(self._places) > 1:
            (x, z), (last_x, last_z) = self._places[self._led_to - 1], self._places[self._led_to]
            self._going = last_x - x, last_z - z
        for item in constraints:
            if isinstance(item, RootTrajectory):
                self._add_path(item)
            elif (place := place_given(item)) is not None and item.frame in window:
                self._places[item.frame] = place
        self._places[start - 1] = (float(root.x), float(root.z))
        self._frames = sorted(self._places)

    def _add_path(self, path: RootTrajectory) -> None:
        first = max(path.first_frame, self._window.start)
        rows = path.xz[first - path.first_frame : max(first, self._window.stop) - path.first_frame]
        self._places.update((frame, (x, z)) for frame, (x, z) in enumerate(rows.tolist(), first))

    def is_led_at(self, frame: int) -> bool:
        """Whether the lead covers a frame."""
        return frame <= self._led_to

    def add(self, frame: int, x: float, z: float) -> None:
        """Add a place, in metres."""
        if frame not in self._places:
            insort(self._frames, frame)
        self._places[frame] = x, z

    def at(self, frame: int) -> tuple[float, float]:
        """Where the root is expected at a frame of the window, x and z in metres."""
        index = bisect_left(self._frames, frame)
        if index == len(self._frames):
            last = self._frames[-1]
            x, z = self._places[last]
            count = min(frame - last, self._most_frames) if last == self._led_to else 0
            return x + self._going[0] * count, z + self._going[1] * count
        after = self._frames[index]
        if after == frame:
            return self._places[frame]
        before = self._frames[index - 1]
        share = (frame - before) / (after - before)
        (x, z), (to_x, to_z) = self._places[before], self._places[after]
        return x + share * (to_x - x), z + share * (to_z - z)


def place_given(item: Constraint) -> tuple[float, float] | None:
    """Where a constraint on a single frame asks the root to be, x and z in metres; None if it does not."""
    match item:
        case Waypoint():
            return item.x, item.z
        case Keyframe():
            x, _, z = item.positions[0].tolist()
            return x, z
        case JointTargets() if 0 in item.joints:
            x, _, z = item.positions[item.joints.index(0)].tolist()
            return x, z
    return None


def behind_places(
    lead: RootTrajectory | None, constraints: Iterable[Constraint], window: range
) -> RootTrajectory | None:
    """What remains of a lead after the last place in a window that constraints ask of the root, moved to start there.

    To these places the character goes without a lead. window: the frames that it sees. None if nothing remains.
    """
    if lead is None:
        return None
    last, place = lead.first_frame - 1, None
    for item in constraints:
        if isinstance(item, RootTrajectory):
            frame = min(item.last_frame, window.stop - 1)
            given = item.xz[frame - item.first_frame] if item.first_frame <= frame else None
        else:
            frame, given = item.frame, place_given(item)
        if given is not None and last < frame < window.stop:
            last, place = frame, given
    begin = last + 1 - lead.first_frame
    if place is None or begin >= len(lead.xz):
        return lead if place is None else None
    moved = lead.xz[begin:] + (np.asarray(place, np.float32) - lead.xz[begin - 1])
    return replace(lead, first_frame=last + 1, xz=moved, heading=None if lead.heading is None else lead.heading[begin:])
