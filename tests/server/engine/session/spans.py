"""Prompt spans for property tests."""

from hypothesis import strategies as st

from motiongen_server.engine.types import Prompt
from tests.server.engine.stage import prompt

SPANS = st.builds(
    lambda marker, prompt_id, start, length: prompt(
        marker, prompt_id, start, None if length is None else start + length
    ),
    st.integers(0, 3),
    st.integers(1, 4),
    st.integers(0, 60),
    st.none() | st.integers(1, 40),
)


def marker(held: Prompt | None) -> int:
    """The number that identifies a test's prompt; -1 if no prompt is in force."""
    return -1 if held is None else int(held.embedding[0])
