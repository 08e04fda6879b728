"""`motiongen view`: serve a page that shows and steers the characters of a server."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import signal
import socket
import webbrowser
from pathlib import Path
from types import FrameType

from motiongen_client.errors import InvalidInput, MissingExtra
from motiongen_client.line_policy import LinePolicy
from motiongen_tools.arguments import add_start_timeout
from motiongen_tools.connection import client_of
from motiongen_tools.console import make_console, starting
from motiongen_tools.server_process import ServerProcess
from motiongen_tools.termination import Terminated

DEFAULT_PORT = 8321
MOST_PORT, MOST_PORT_DIGITS = 65535, 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command, except those that choose the server."""
    parser.add_argument(
        "--listen", default="127.0.0.1", metavar="HOST", help="address to serve the page at (default: %(default)s); "
        "except on loopback, it takes a token to steer, and another to watch",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=_port, default=DEFAULT_PORT, help="port of the page; 0 takes a free one (default: %(default)s)"
    )
    parser.add_argument("--token", action="store_true", help="require tokens on loopback too")
    parser.add_argument("--open", action="store_true", help="open the page in a browser")
    parser.add_argument("--three", type=Path, metavar="FOLDER", help="folder of the npm package three, if not found")
    add_start_timeout(parser)


async def view(options: argparse.Namespace) -> int:
    """Serve the page until interrupted."""
    try:
        import uvicorn

        from motiongen_tools.view.web import web_app
    except ImportError:
        raise MissingExtra("the viewer", "starlette, uvicorn and websockets", "view") from None
    from motiongen_tools.view.access import Access
    from motiongen_tools.view.bridge import Bridge
    from motiongen_tools.view.line import Line
    from motiongen_tools.view.page_files import three_folder

    three = three_folder(options.three)
    access = Access.to_listen_at(options.listen, options.token)
    listening = _listen(options.listen, options.port)
    with contextlib.ExitStack() as stack:
        stack.callback(listening.close)
        address = options.server
        if options.start_server:
            with starting(make_console(), "starting a server with the built-in model") as tell:
                own = ServerProcess([], ready_timeout_s=options.start_timeout, tell=tell)
                address = stack.enter_context(own).address
        bridge = Bridge(Line(lambda: client_of(options, address, LinePolicy())))
        settings = uvicorn.Config(
            web_app(bridge, access, three), ws="websockets-sansio", log_config=None, access_log=False, lifespan="off",
            ws_per_message_deflate=False, ws_max_size=1 << 20, timeout_graceful_shutdown=2,
        )  # fmt: skip
        server = uvicorn.Server(settings)
        ended_by: list[int] = []

        def note(sig: int, frame: FrameType | None) -> None:
            ended_by.append(sig)
            server.should_exit = True
            logging.getLogger("uvicorn").setLevel(logging.CRITICAL)  # requests that are cut off now are not failures

        server.handle_exit = note  # type: ignore[method-assign]  # uvicorn's own raises the signal again, in its task
        _say_where(listening, access.control_token, access.watch_token, address, options.open)
        logging.getLogger("uvicorn").setLevel(logging.WARNING)
        running = asyncio.create_task(bridge.run())
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        try:
            await asyncio.wait((running, serving), return_when=asyncio.FIRST_COMPLETED)
        finally:
            server.should_exit = True
            await serving
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running  # raises the reason if the bridge ended by itself
    if ended_by:
        raise KeyboardInterrupt if ended_by[0] == signal.SIGINT else Terminated(128 + ended_by[0])
    return 0


def _port(text: str) -> int:
    """A port. Raises ArgumentTypeError, since some systems would use just the lower 16 bits of a larger number."""
    if not text.isascii() or not text.isdigit() or len(text) > MOST_PORT_DIGITS or int(text) > MOST_PORT:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a whole number from 0 to {MOST_PORT}")
    return int(text)


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises InvalidInput if the address is in use or does not belong to this machine."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        return socket.create_server(found[4][:2], family=found[0])
    except (OSError, OverflowError, ValueError) as error:  # ValueError: not a host name, such as two dots in a row
        raise InvalidInput("--listen, --port", f"{host}:{port}", f"a free address of this machine ({error})") from error


def _say_where(listening: socket.socket, control: str | None, watch: str | None, server: str, opens: bool) -> None:
    host, port = listening.getsockname()[:2]
    page = f"http://{f'[{host}]' if ':' in host else host}:{port}/"
    console = make_console()
    address = page if control is None else f"{page}#token={control}"
    console.print(f"the page: {address}", soft_wrap=True)
    if watch is not None:
        console.print(f"to watch: {page}#token={watch}", soft_wrap=True)
    console.print(f"characters of {server}; Ctrl+C ends", soft_wrap=True)
    if opens:
        webbrowser.open(address)
