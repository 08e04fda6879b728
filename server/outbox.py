"""Outbox: what one stream still has to send, in order, with superseded frames taken out."""

from __future__ import annotations

from dataclasses import replace

from server.engine.types import Chunk, Outcome, Output, PlanNotice

UPDATE_OVERHEAD_BYTES = 64


class Outbox:
    """Outputs that wait to be written. A plan notice removes the frames it replaces that have not been sent yet."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Output, int]] = []
        self.num_bytes = 0
        self.dropped_frames = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, output: Output, applied_seq: int) -> None:
        """Add one output at the end. applied_seq: the session's as of this output, to be told with it."""
        if isinstance(output, PlanNotice):
            self._supersede(output)
        self._waiting.append((output, applied_seq))
        self.num_bytes += size_of(output)

    def _supersede(self, notice: PlanNotice) -> None:
        kept: list[tuple[Output, int]] = []
        for output, applied_seq in self._waiting:
            if isinstance(output, Chunk) and output.session == notice.session:
                left = max(0, notice.valid_from - output.first_frame)
                if left < len(output.rows):
                    self.dropped_frames += len(output.rows) - left
                    self.num_bytes -= size_of(output)
                    if left == 0:
                        continue
                    output = replace(output, rows=output.rows[:left])
                    self.num_bytes += size_of(output)
            kept.append((output, applied_seq))
        self._waiting = kept

    def take(self, max_bytes: int) -> list[tuple[Output, int]]:
        """The oldest outputs that fit into one message of max_bytes, at least one if there is any; see `put`."""
        count, total = 0, 0
        for output, _ in self._waiting:
            total += size_of(output)
            if count and total > max_bytes:
                break
            count += 1
        taken, self._waiting = self._waiting[:count], self._waiting[count:]
        self.num_bytes -= sum(size_of(output) for output, _ in taken)
        return taken


def size_of(output: Output) -> int:
    """About how many bytes an output takes on the wire."""
    if isinstance(output, Chunk):
        return UPDATE_OVERHEAD_BYTES + output.rows.nbytes
    if isinstance(output, Outcome):
        return UPDATE_OVERHEAD_BYTES + len(output.reason + output.message + output.field + output.allowed)
    return UPDATE_OVERHEAD_BYTES
