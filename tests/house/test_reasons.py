"""docs/protocol.md lists every reason that the server gives in refusals and warnings, and no other."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Any

REASON = re.compile(r"[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)+|INTERNAL")
REFUSALS = {
    "CannotKeep",
    "EventRefused",
    "StreamRefused",
    "Outcome",
    "Warned",
    "refuse",
    "_refusal",
    "_full",
    "check_range",
    "check_count",
}
# Built from the name of what was edited.
COMPOSED = {"UNKNOWN_PROMPT", "UNKNOWN_CONSTRAINT"}
# Values that messages name as allowed.
VALUES = {"F32_LE"}


def reasons_in(source: str) -> Iterator[str]:
    """What looks like a reason in a refusal's arguments, in a tuple of its parts, or assigned to `reason`."""
    for node in ast.walk(ast.parse(source)):
        is_refusal = isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in REFUSALS
        is_reason = isinstance(node, ast.Assign) and any(getattr(name, "id", "") == "reason" for name in node.targets)
        if is_refusal or is_reason or isinstance(node, ast.Tuple):
            for inner in ast.walk(node):
                if isinstance(inner, ast.Constant) and isinstance(inner.value, str) and REASON.fullmatch(inner.value):
                    yield inner.value


def test_page_lists_the_reasons_that_the_server_gives(repository: Any) -> None:
    given = set(COMPOSED)
    for path in repository.files:
        if path.parts[0] == "server" and path.suffix == ".py":
            given |= set(reasons_in((repository.root / path).read_text(encoding="utf-8")))
    page = (repository.root / "docs" / "protocol.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    listed = {word for line in rows for word in re.findall(r"`([A-Z_]+)`", line) if REASON.fullmatch(word)}
    assert sorted(given - listed - VALUES) == [], "not in docs/protocol.md"
    assert sorted(listed - given) == [], "in docs/protocol.md, but the server never gives them"


def test_reasons_are_found_in_source() -> None:
    source = "raise EventRefused(code, 'NO_SUCH_THING', 'no')\nLEVEL = 'LOG_LEVEL'\nreason = 'TOO_FAR' if x else ''"
    assert sorted(reasons_in(source)) == ["NO_SUCH_THING", "TOO_FAR"]
