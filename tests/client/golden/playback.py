"""Golden vectors of poses between frames, in the course of a session."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np

from motiongen_client.playback import Playback
from motiongen_client.sampling import Sampler
from tests.client.golden.draws import RATE_HZ, RIG, drawn_rows, numbers

OTHERS = ("pause", "resume", "scale", "wait")


class Script:
    """A possible session: replans, waits, cuts, losses, pauses, another pace; and what is shown at each time."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.now_s = 0.0
        self.plan = 0
        self.received = 0

    def lines(self) -> Iterator[str]:
        yield f"begin {RATE_HZ}"
        for _ in range(60):
            match self.draw.choices(("plan", "chunk", "loss", *OTHERS), (2, 5, 1, 1, 1, 1, 10))[0]:
                case "plan":
                    yield self.new_plan()
                case "chunk" if self.plan:
                    yield self.new_chunk(self.draw.randint(1, 6))
                case "loss" if self.plan:
                    yield from self.loss()
                case "scale":
                    yield f"scale {self.draw.choice([0.5, 1, 1, 2])}"
                case "pause" | "resume" as name:
                    yield name
                case _:
                    yield from self.wait(self.draw.randint(1, 4))

    def new_chunk(self, count: int) -> str:
        first, self.received = self.received, self.received + count
        return f"chunk {self.plan} {first} {count} {numbers(drawn_rows(self.draw, count))}"

    def wait(self, num_samples: int) -> Iterator[str]:
        for _ in range(num_samples):
            self.now_s += self.draw.choice([1 / 60, 1 / 144, 0.0317, 0.11])
            yield f"sample {self.now_s:.9f}"

    def loss(self) -> Iterator[str]:
        """Playback continues; then one plan comes for all that were missed, and a cut known from its outcome."""
        yield from self.wait(self.draw.randint(2, 15))
        back = self.draw.randint(2, 8)
        self.plan += 1
        self.received = max(self.received - back, 0)
        yield f"plan {self.plan} {self.received} 0"
        yield f"cut {self.received + self.draw.randint(0, 3)}"
        yield self.new_chunk(back + self.draw.randint(2, 4))

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
        self.num_passed_cuts = 0

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
            case "cut":
                frame = int(words[0])
                self.num_passed_cuts += playback.note_cut(frame) > frame
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
