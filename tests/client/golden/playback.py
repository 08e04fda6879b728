"""Golden vectors of poses between frames, in the course of a session."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np

from motiongen_client.playback import Playback
from motiongen_client.sampling import Sampler
from tests.client.golden.draws import RATE_HZ, RIG, drawn_rows, numbers


class Script:
    """A possible session: replans, waits, cuts, pauses, another pace; and what is shown at each time."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.now_s = 0.0
        self.plan = 0
        self.received = 0

    def lines(self) -> Iterator[str]:
        yield f"begin {RATE_HZ}"
        for _ in range(60):
            match self.draw.choices(("plan", "chunk", "pause", "resume", "scale", "wait"), (2, 5, 1, 1, 1, 10))[0]:
                case "plan":
                    yield self.new_plan()
                case "chunk" if self.plan:
                    count = self.draw.randint(1, 6)
                    rows = drawn_rows(self.draw, count)
                    yield f"chunk {self.plan} {self.received} {count} {numbers(rows)}"
                    self.received += count
                case "scale":
                    yield f"scale {self.draw.choice([0.5, 1, 1, 2])}"
                case "pause" | "resume" as name:
                    yield name
                case _:
                    for _ in range(self.draw.randint(1, 4)):
                        self.now_s += self.draw.choice([1 / 60, 1 / 144, 0.0317])
                        yield f"sample {self.now_s:.9f}"

    def new_plan(self) -> str:
        self.plan += 1
        back = self.draw.randint(0, 4) if self.draw.random() < 0.7 else 0
        self.received = max(self.received - back, 0)
        return f"plan {self.plan} {self.received} {int(self.draw.random() < 0.2)}"


class Player:
    """The Python client, which executes the lines of a script."""

    def __init__(self) -> None:
        self.playback = Playback(RATE_HZ, RIG.row_width)
        self.sampler = Sampler(RIG, self.playback)

    def tell(self, line: str) -> str:
        """Execute a line. Returns its result: for `sample` the playhead and the row, or nothing before there is one."""
        name, *words = line.split()
        playback = self.playback
        match name:
            case "begin":
                self.__init__()  # type: ignore[misc]
            case "plan":
                playback.announce_plan(int(words[0]), int(words[1]), is_cut=words[2] == "1")
            case "chunk":
                plan, first, count = map(int, words[:3])
                rows = np.array(words[3:], np.float32).reshape(count, RIG.row_width)
                playback.add_chunk(plan, first, rows, 0)
            case "pause":
                playback.pause()
            case "resume":
                playback.resume()
            case "scale":
                playback.set_time_scale(float(words[0]))
            case "sample":
                playback.advance(float(words[0]))
                if not playback.started:
                    return "-1"
                _, row = self.sampler.row(float(words[0]))
                return f"{playback.playhead} {numbers(row)}"
        return ""


def sampling() -> Iterator[str]:
    for seed in range(5):
        player = Player()
        for line in Script(seed).lines():
            yield f"{line} -> {player.tell(line)}".rstrip()
