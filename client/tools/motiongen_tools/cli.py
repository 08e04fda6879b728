"""The command line: `motiongen stream`, `generate`, `view`, `gallery`, `bench` and others, each in its own module."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import io
import logging
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from motiongen_client.errors import MotiongenError
from motiongen_tools import (
    cli_admin,
    cli_bench,
    cli_catalog,
    cli_gallery,
    cli_generate,
    cli_replay,
    cli_stream,
    cli_view,
)
from motiongen_tools.arguments import MOST_SEED, add_start_timeout, whole_number
from motiongen_tools.cli_script import AtAction, PromptAction, Script, check_generate, check_stream
from motiongen_tools.connection import add_connection, check_started
from motiongen_tools.demo import command
from motiongen_tools.demo.script import PLACE_BOUND_M, STORY_S
from motiongen_tools.termination import Terminated, terminating

DEFAULT_SERVER = "localhost:50051"


def run(arguments: Sequence[str]) -> int:
    """Run one command. Returns 0, 1 if it failed, 2 for wrong arguments, 130 if interrupted, 143 after SIGTERM."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # as standard error: an odd file name must not end a command
    try:
        with warnings_shown(), terminating(), asyncio.Runner() as runner:
            options = parse(arguments)
            result: int = runner.run(options.command(options))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except Terminated as end:
        print("terminated", file=sys.stderr)
        return int(end.code or 0)
    except SystemExit as end:  # argparse has printed why, or the help
        return int(end.code or 0)
    except (MotiongenError, OSError) as error:  # OSError: a disk that is full, a folder that is gone
        print(f"error: {error}", file=sys.stderr)
        return 1
    return result


@contextlib.contextmanager
def warnings_shown() -> Iterator[None]:
    """Print the library's warnings on standard error: what a model was not trained for, and refusals."""
    shown = logging.StreamHandler(sys.stderr)
    shown.setFormatter(logging.Formatter("warning: %(message)s"))
    log = logging.getLogger("motiongen_client")
    log.addHandler(shown)
    try:
        yield
    finally:
        log.removeHandler(shown)


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The options of a command line. If they are wrong, prints why and exits with 2."""
    parser = _parser()
    for argument in arguments:
        if not _is_text(argument):  # printing or sending it would fail
            parser.error(f"{argument!r} is not valid UTF-8 text")
    arguments, settings = _server_settings(list(arguments))
    arguments = _with_places(arguments)
    options = parser.parse_args(arguments)
    if options.command is cli_generate.generate:
        options.server_arguments = settings
        check_generate(parser, options)
    if options.command is cli_stream.stream:
        check_stream(parser, options)
    if options.command is cli_bench.bench:
        cli_bench.check(parser, options)
    check_started(parser, options)
    return options


def _server_settings(arguments: list[str]) -> tuple[list[str], list[str]]:
    """Split off what follows `--` of generate: argparse cannot distinguish it from a prompt."""
    if arguments[:1] != ["generate"] or "--" not in arguments:
        return arguments, []
    at = arguments.index("--")
    return arguments[:at], arguments[at + 1 :]


def _is_text(argument: str) -> bool:
    """Whether an argument is valid text. The system passes bytes that are not UTF-8 on as surrogates."""
    try:
        argument.encode()
    except UnicodeEncodeError:
        return False
    return True


def _with_places(arguments: list[str]) -> list[str]:
    """Join `--waypoint -1,2@3` into one argument: argparse would take the coordinates for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] == "--waypoint" and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="motiongen", description="Characters that obey prompts and waypoints.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    stream = commands.add_parser(
        "stream",
        help="generate the motion of one character and write it to files",
        description="Generate the motion of one character and write it as BVH, and as NPZ and PNG if asked for.",
        epilog='Example: motiongen stream --prompt "a person walks forward" --at 4 --prompt "a person runs" '
        "--waypoint 0.5,4@3 --seconds 8 --out motion.bvh --npz --png",
    )
    stream.set_defaults(command=cli_stream.stream, script=Script())
    _add_server(stream)
    add_connection(stream)
    stream.add_argument(
        "--prompt", action=PromptAction, metavar="TEXT", help="what to do; again, after --at, to change it"
    )
    stream.add_argument("--at", action=AtAction, metavar="SECONDS", help="when the next --prompt takes over")
    stream.add_argument(
        "--waypoint",
        action="append",
        default=[],
        type=cli_stream.parse_waypoint,
        metavar="X,Z@SECONDS",
        help="be at world x, z (metres) at a time; again for more. X,Z,HEADING@SECONDS gives the heading too (radians)",
    )
    stream.add_argument("--seconds", type=_positive, default=8.0, help="how long (default: %(default)s)")
    stream.add_argument(
        "--out", type=_bvh_path, default=Path("motion.bvh"), metavar="FILE", help="BVH file (default: %(default)s)"
    )
    stream.add_argument("--npz", action="store_true", help="write FILE.npz too: the arrays, joint positions included")
    stream.add_argument("--png", action="store_true", help="write FILE.png too: path and skeletons (needs matplotlib)")
    stream.add_argument(
        "--seed", type=whole_number(0, MOST_SEED), help="same seed, same motion (default: the server draws one)"
    )
    stream.add_argument(
        "--steps", type=whole_number(1), metavar="N", help="denoising steps of a window (default: the server's)"
    )
    stream.add_argument("--model", default="", metavar="NAME", help="model of the catalogue (default: its first)")
    stream.add_argument("--realtime", action="store_true", help="take frames in real time, not as fast as they come")

    generate = commands.add_parser(
        "generate",
        help="generate clips as fast as a server makes them, and write them to files",
        description="Generate bounded clips, several samples at once, and write them in the formats of animation and "
        "robot tools. The server makes them in the background of its sessions.",
        usage="motiongen generate [options] [PROMPT] [-- SETTING ...]",
        epilog='Example: motiongen generate "a person walks forward" --at 3 --prompt "a person runs" --seconds 6 '
        "--samples 4 --out walk.npz --start-server. What follows -- are settings of the server that is started.",
    )
    generate.set_defaults(command=cli_generate.generate, script=Script())
    where = generate.add_mutually_exclusive_group()
    _add_server(where)
    add_connection(generate)
    where.add_argument("--start-server", action="store_true", help="start a server for this; its settings follow --")
    generate.add_argument("prompt", nargs="?", metavar="PROMPT", help="what to do from the start")
    generate.add_argument(
        "--prompt", dest="script", action=PromptAction, metavar="TEXT", help="after --at, what to do next"
    )
    generate.add_argument("--at", action=AtAction, metavar="SECONDS", help="when the next --prompt takes over")
    cli_generate.add_arguments(generate)

    catalog = commands.add_parser("catalog", help="show what a server offers", description="Show what a server offers.")
    catalog.set_defaults(command=cli_catalog.catalog)
    _add_server(catalog)
    add_connection(catalog)

    show = commands.add_parser(
        "demo",
        help="start a server and play a story of one character, with seven beside it",
        description="Start a server with the built-in model and play a script on one stream, faster than real time: a "
        "character stands, walks, turns, goes to places, stops and waves, and seven others show velocities, a path, "
        "turns, hands, styles, gestures and a prompt outside what the model knows. Writes a BVH file for each and two "
        "contact sheets, and prints how near each goal came. Needs motiongen-server, unless --server is given.",
        epilog="Exit code 1: a frame or a character is missing, or a waypoint was missed by more than --bound.",
    )
    show.set_defaults(command=command.demo)
    show.add_argument("--out", type=Path, default=Path("demo_out"), metavar="FOLDER", help="default: %(default)s")
    seconds = "how much of the script (default: %(default)s, all of it)"
    show.add_argument("--seconds", type=_positive, default=STORY_S, help=seconds)
    bound = "what a waypoint may be missed by (default: %(default)s)"
    show.add_argument("--bound", type=_positive, default=PLACE_BOUND_M, metavar="METRES", help=bound)
    show.add_argument("--server", metavar="HOST:PORT", help="use this server instead of starting one")
    add_start_timeout(show)
    add_connection(show)

    bench = commands.add_parser(
        "bench",
        help="put a load on a server and measure it",
        description="Put a load on a server: many characters that play in real time and are given edits at times "
        "fixed in advance. Prints what was measured and writes it as JSON, PNG and HTML.",
        epilog="Example: motiongen bench --start-server --scenario crowd --characters 40 --seconds 20 --seed 1. "
        "Exit code 3: the load itself was late, and the figures do not count.",
    )
    bench.set_defaults(command=cli_bench.bench)
    which = bench.add_mutually_exclusive_group()
    _add_server(which)
    which.add_argument("--start-server", action="store_true", help="start a server for this, and measure what it uses")
    cli_bench.add_arguments(bench)
    add_connection(bench)

    view = commands.add_parser(
        "view",
        help="see and steer characters in a browser",
        description="Serve a page that shows the characters of a server and lets you steer them.",
        epilog="Example: motiongen view --server localhost:50051 --open",
    )
    view.set_defaults(command=cli_view.view)
    viewed = view.add_mutually_exclusive_group()
    _add_server(viewed)
    viewed.add_argument("--start-server", action="store_true", help="start a server with the built-in model for this")
    add_connection(view)
    cli_view.add_arguments(view)

    again = commands.add_parser(
        "replay",
        help="play a session file of the viewer again",
        description="Open a character as a session file says, make its edits at the same frames, and write the motion.",
    )
    again.set_defaults(command=cli_replay.replay)
    _add_server(again)
    add_connection(again)
    cli_replay.add_arguments(again)

    shown = commands.add_parser(
        "gallery",
        help="write a page of what a model makes of its presets and of targets",
        description="Ask models for each of their presets and for a target of each kind, and write a page that plays "
        "what came. It opens from the disk, without a server. Needs motiongen-server, unless --server is given.",
        epilog="Example: motiongen gallery motiongen-mini out/training/denoiser --out out/gallery.html",
    )
    shown.set_defaults(command=cli_gallery.gallery)
    cli_gallery.add_arguments(shown)
    add_connection(shown)

    admin = commands.add_parser(
        "admin",
        help="load and unload the models of a running server",
        description="Load, unload and reload the models of a server that was started with --admin-listen, on its own "
        "machine. Sessions of other models continue meanwhile.",
        epilog="Example: motiongen admin load g1; motiongen admin unload motiongen-mini --grace 30",
    )
    admin.set_defaults(command=cli_admin.admin)
    cli_admin.add_arguments(admin, cli_stream.parse_seconds)
    return parser


def _add_server(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--server", default=DEFAULT_SERVER, metavar="HOST:PORT", help="or unix:PATH (default: %(default)s)"
    )


def _positive(text: str) -> float:
    seconds = cli_stream.parse_seconds(text)
    if seconds == 0:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a number of seconds above 0")
    return seconds


def _bvh_path(text: str) -> Path:
    path = Path(text)
    if path.suffix not in ("", ".bvh"):
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a name that ends in .bvh or has no ending")
    return path.with_suffix(".bvh")
