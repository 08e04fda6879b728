"""An error that lists every problem of its input, not only the first one."""

from __future__ import annotations

from collections.abc import Sequence

MAX_LISTED = 50


class Problems(ValueError):
    """problems: all of them, one line each. The message lists the first MAX_LISTED."""

    def __init__(self, problems: str | Sequence[str]) -> None:
        self.problems = (problems,) if isinstance(problems, str) else tuple(dict.fromkeys(problems))
        more = len(self.problems) - MAX_LISTED
        listed = "; ".join(self.problems[:MAX_LISTED])
        super().__init__(f"{listed}; and {more} more" if more > 0 else listed)
