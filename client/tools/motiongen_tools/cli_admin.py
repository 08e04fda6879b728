"""`motiongen admin`: load, unload and reload the models of a running server."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from motiongen_client.admin import AdminClient, ModelStatus
from motiongen_tools.connection import add_token, read_token
from motiongen_tools.console import make_console, make_table

DEFAULT_ADDRESS = "localhost:50052"


def add_arguments(parser: argparse.ArgumentParser, seconds: Callable[[str], float]) -> None:
    """Add the subcommands of the command. seconds: parses a time."""
    parser.add_argument(
        "--server", default=DEFAULT_ADDRESS, metavar="HOST:PORT", help="its --admin-listen (default: %(default)s)"
    )
    add_token(parser)
    deeds = parser.add_subparsers(required=True, metavar="DEED", dest="deed")
    listing = deeds.add_parser("list", help="which models it holds, and what they are doing")
    load = deeds.add_parser("load", help="load one more model")
    load.add_argument("source", metavar="SOURCE", help="a name, a folder of its machine, or a hub's owner/name")
    others = []
    for name, meaning in (("unload", "unload a model"), ("reload", "load a model again, from its source")):
        deed = deeds.add_parser(name, help=meaning)
        others.append(deed)
        deed.add_argument("model", metavar="MODEL", help="name as in the list")
        deed.add_argument(
            "--grace",
            type=seconds,
            metavar="SECONDS",
            help="how long its sessions may continue before they are closed (default: refused while any is open)",
        )
    for each in (listing, load, *others):
        # Also accepted after the subcommand. If not given there, the value given before it stays.
        each.add_argument("--server", default=argparse.SUPPRESS, metavar="HOST:PORT", help=argparse.SUPPRESS)
        each.add_argument("--token-file", default=argparse.SUPPRESS, type=Path, metavar="FILE", help=argparse.SUPPRESS)


async def admin(options: argparse.Namespace) -> int:
    """Make the call, and print the result."""
    console = make_console()
    async with AdminClient(options.server, token=read_token(options.token_file)) as client:
        if options.deed == "load":
            status = await client.load_model(options.source)
            console.print(f"{status.model_id} is served now.", soft_wrap=True)
        elif options.deed == "unload":
            closed = await client.unload_model(options.model, options.grace)
            console.print(f"{options.model} is unloaded; {_sessions(closed)} closed.", soft_wrap=True)
        elif options.deed == "reload":
            status, closed = await client.reload_model(options.model, options.grace)
            console.print(f"{status.model_id} is reloaded; {_sessions(closed)} closed.", soft_wrap=True)
        else:
            table = make_table("models", "name", "state", "sessions", "load", "loaded from")
            for status in await client.list_models():
                table.add_row(*_row(status))
            console.print(table)
    return 0


def _row(status: ModelStatus) -> tuple[str, str, str, str, str]:
    state = f"{status.state}: {status.message}" if status.message else status.state
    return status.model_id or "?", state, str(status.sessions), f"{status.load:.0%}", status.source


def _sessions(count: int) -> str:
    return f"{count} session was" if count == 1 else f"{count} sessions were"
