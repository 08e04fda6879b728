"""Terminal output with rich: tables and progress bars."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from motiongen_client.errors import MissingExtra

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table


def make_console() -> Console:
    """A console on standard output that prints texts literally, because names of servers and files may contain
    brackets.

    Raises MissingExtra without rich.
    """
    try:
        from rich.console import Console
    except ImportError:
        raise MissingExtra("the command line", "rich", "") from None
    return Console(highlight=False, markup=False, emoji=False)


def make_progress(console: Console) -> Progress:
    """A progress bar with a description, a state and the elapsed time. It disappears when finished."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=40),
        TextColumn("{task.fields[state]}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    )


@contextlib.contextmanager
def starting(console: Console, what: str) -> Iterator[Callable[[str], None]]:
    """Show that something is starting. Yields a function that shows a line of its log below, as a sign of progress."""
    from rich.text import Text

    with console.status(what) as status:

        def tell(line: str) -> None:
            shown = Text.from_ansi(line)
            shown.truncate(console.width - 4, overflow="ellipsis")
            status.update(Text(f"{what}\n  ").append_text(shown))

        yield tell


def make_table(title: str, *columns: str) -> Table:
    """An empty table. Columns after the first are right-aligned.

    Where the terminal is narrow, texts continue on the next line; a name that was cut short could not be used.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if index else "left", overflow="fold")
    return table
