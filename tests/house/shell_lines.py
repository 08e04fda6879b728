"""The shell lines of a Markdown page: blocks indented by four spaces, without their comments."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass

FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
SEPARATORS = {"&&", ";", "|"}
REDIRECTIONS = {">", "2>", "<"}
SHORT = {"motiongen": "motiongen_tools", "motiongen-server": "motiongen_server"}
"""Console scripts, and the modules that they run."""


@dataclass(frozen=True)
class Command:
    """A command on the page: `make`, or the name of a Python module, with arguments."""

    program: str
    arguments: tuple[str, ...]


def commands_in(page: str) -> list[Command]:
    """The commands of make, our console scripts, and `python -m`, in the order of the page."""
    lines = re.findall(r"^ {4}(?=\S)((?:.*\\\n)*.*)$", FENCED.sub("", page), re.MULTILINE)
    found = []
    for line in lines:
        for words in _parts(line.replace("\\\n", " ")):
            command = _command(words)
            if command is not None:
                found.append(command)
    return found


def _parts(line: str) -> list[list[str]]:
    """The words of each command of a line; none if the line cannot be parsed as a shell line."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError:
        return []
    parts: list[list[str]] = [[]]
    for word in words:
        if word in SEPARATORS or word.endswith(";"):
            parts.append([])
        else:
            parts[-1].append(word)
    return parts


def _command(words: list[str]) -> Command | None:
    if not words:
        return None
    program, *arguments = words
    program = program.rpartition("/")[2]
    arguments = _without_redirections(arguments)
    if program in SHORT:
        return Command(SHORT[program], tuple(arguments))
    if program == "python" and arguments[:1] == ["-m"]:
        return Command(arguments[1], tuple(arguments[2:]))
    return Command(program, tuple(arguments)) if program == "make" else None


def _without_redirections(words: list[str]) -> list[str]:
    kept: list[str] = []
    skips = False
    for word in words:
        if not skips and word not in REDIRECTIONS:
            kept.append(word)
        skips = word in REDIRECTIONS
    return kept
