"""Every command on a page exists: targets of make, modules, and options that their programs accept."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest

from motiongen_server.config import parse_config
from motiongen_tools import cli
from tests.conftest import LiveServer
from tests.house.shell_lines import Command, commands_in

ROOT = Path(__file__).resolve().parents[2]
TARGET = re.compile(r"^([a-z][a-z-]*):", re.MULTILINE)
IN_TEXT = re.compile(r"`make ([a-z][a-z-]*)")
IN_TREE = re.compile(r"`((?:ardy|client|compliance|deploy|docs|proto|server|tests)/[\w./-]+)`")
MODULE = re.compile(r"python -m ([a-z][\w.]*\w)")
PACKAGES = {
    "motiongen_ardy",
    "motiongen_client",
    "motiongen_compliance",
    "motiongen_server",
    "motiongen_tools",
    "tests",
    "pip",
}
PARSERS = {"motiongen_tools": cli.parse, "motiongen_server": parse_config}
"""Programs whose arguments can be parsed without running them."""


@pytest.fixture(scope="module")
def pages(repository: Any) -> dict[str, str]:
    """Pages with commands for users or contributors, so without the log and the decision records."""
    names = [path for path in repository.files if path.suffix == ".md" and path.name not in ("CHANGELOG.md", "log.md")]
    return {path.as_posix(): (ROOT / path).read_text(encoding="utf-8") for path in names if "adr" not in path.parts}


def told(pages: dict[str, str]) -> list[tuple[str, Command]]:
    return [(page, command) for page, text in pages.items() for command in commands_in(text)]


def test_make_targets_exist(pages: dict[str, str]) -> None:
    targets = set(TARGET.findall((ROOT / "Makefile").read_text(encoding="utf-8")))
    named = {(page, command.arguments[0]) for page, command in told(pages) if command.program == "make"}
    named |= {(page, target) for page, text in pages.items() for target in IN_TEXT.findall(text)}
    assert sorted((page, target) for page, target in named if target not in targets) == []
    assert len(named) > 30


def test_modules_and_files_named_in_the_text_exist(pages: dict[str, str], repository: Any) -> None:
    folders = {str(parent) for path in repository.files for parent in path.parents}
    there = folders | {path.as_posix() for path in repository.files}
    paths = {(page, path.rstrip("/")) for page, text in pages.items() for path in IN_TREE.findall(text)}
    starts = {
        page: ("", "tests/", f"{Path(page).parent.as_posix()}/", "client/cpp/include/motiongen/") for page in pages
    }
    missing = [(page, path) for page, path in paths if not any(f"{start}{path}" in there for start in starts[page])]
    assert sorted(missing) == []
    modules = {(page, module) for page, text in pages.items() for module in MODULE.findall(text)}
    assert sorted((page, module) for page, module in modules if module.split(".")[0] not in PACKAGES) == []
    assert len(paths) > 30
    assert len(modules) > 30


def test_programs_accept_their_arguments(pages: dict[str, str]) -> None:
    refused = []
    for page, command in told(pages):
        parse = PARSERS.get(command.program)
        if parse is None:
            continue
        try:
            parse(list(command.arguments))
        except (SystemExit, Exception) as error:
            refused.append((page, command, repr(error)))
    assert refused == []


def test_other_modules_exist_and_have_the_options(pages: dict[str, str]) -> None:
    missing = []
    for page, command in told(pages):
        if command.program == "make" or command.program in PARSERS:
            continue
        found = importlib.util.find_spec(command.program)
        if found is None or found.origin is None:
            missing.append((page, command.program))
            continue
        file = Path(found.origin)
        files = file.parent.glob("*.py") if file.name == "__init__.py" else [file, *file.parent.glob("*.py")]
        source = "".join(each.read_text(encoding="utf-8") for each in files)
        options = [word.strip("[]") for word in command.arguments if word.strip("[]").startswith("--")]
        missing += [(page, f"{command.program} {option}") for option in options if not takes(source, option)]
    assert missing == []


def takes(source: str, option: str) -> bool:
    """Whether a program declares an option: itself, or as a field of its settings."""
    return f'"{option}"' in source or f" {option[2:].replace('-', '_')}: " in source


def commands_of_the_readme() -> list[Command]:
    return commands_in((ROOT / "README.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize("number", range(3))
def test_commands_of_the_readme_run(
    number: int, live_server: LiveServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = [command for command in commands_of_the_readme() if command.program == "motiongen_tools"][number]
    words = [word for word in command.arguments if word != "--start-server"]
    outputs = [Path(words[at + 1]) for at, word in enumerate(words) if word == "--out"]
    if "--samples" in words:
        words[words.index("--samples") + 1] = "1"  # fewer, as a process of its own converts each
    monkeypatch.chdir(tmp_path)
    assert cli.run([*words, "--server", live_server.address]) == 0
    assert outputs
    for output in outputs:
        stems = {path.stem.rpartition("_")[0] or path.stem for path in tmp_path.rglob(f"*{output.suffix}")}
        assert output.stem in stems, f"{output} was not written"


def test_readme_has_commands() -> None:
    programs = [command.program for command in commands_of_the_readme()]
    assert (programs.count("motiongen_tools"), programs.count("motiongen_server")) == (3, 1)


def test_command_is_read_as_by_a_shell() -> None:
    page = """Text.

    umask 077; .venv/bin/motiongen stream --prompt "a b" \\
        --out x.bvh > log   # a remark
    python -m tests.bench --quick && make test ARGS='-k x'

```
    make nothing
```
"""
    assert commands_in(page) == [
        Command("motiongen_tools", ("stream", "--prompt", "a b", "--out", "x.bvh")),
        Command("tests.bench", ("--quick",)),
        Command("make", ("test", "ARGS=-k x")),
    ]
