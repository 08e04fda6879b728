"""`motiongen gallery`: a page of what models make of their presets and of targets, for example after training."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from motiongen_client.client import MotionClient
from motiongen_client.types import Model
from motiongen_tools.arguments import MOST_SEED, add_start_timeout, check_file_to_write, whole_number
from motiongen_tools.connection import PLAIN, connection_of
from motiongen_tools.console import make_console, starting
from motiongen_tools.gallery.asking import ask_all
from motiongen_tools.gallery.evaluated import read_takes
from motiongen_tools.gallery.page_file import Gallery, write_gallery
from motiongen_tools.out_files import page_path
from motiongen_tools.server_process import ServerProcess

DEFAULT_SEED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command, except those for the connection."""
    parser.add_argument(
        "models", nargs="+", metavar="MODEL", help="a built-in model, a checkpoint folder, or a name of --server's "
        "catalogue; several are shown side by side",
    )  # fmt: skip
    parser.add_argument(
        "--steps", type=_steps, default=[None], metavar="N,N", help="denoising steps; several are shown side by side "
        "(default: each model's own)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=whole_number(0, MOST_SEED), default=DEFAULT_SEED, help="of all takes (default: %(default)s)"
    )
    parser.add_argument("--takes", type=Path, metavar="FOLDER", help="also show the takes that make gate wrote there")
    parser.add_argument(
        "--out", type=page_path, default=Path("gallery.html"), metavar="FILE", help="the page (default: %(default)s)"
    )
    parser.add_argument("--server", metavar="HOST:PORT", help="use this server instead of starting one for each model")
    add_start_timeout(parser)


async def gallery(options: argparse.Namespace) -> int:
    """Ask every model all questions, and write the page."""
    console = make_console()
    columns = [(model, steps) for model in options.models for steps in options.steps]
    names = [Path(model).name + ("" if steps is None else f", {steps} steps") for model, steps in columns]
    check_file_to_write("--out", options.out)
    evaluated = [] if options.takes is None else read_takes(options.takes)  # reports a wrong folder before the work
    page = Gallery(" / ".join(Path(model).name for model in options.models), names)
    for model in options.models:
        with contextlib.ExitStack() as stack:
            address, connection = options.server, connection_of(options)
            if address is None:
                with starting(console, f"starting a server with {model}") as tell:
                    # nobody is watching: generate as many clips at once as possible, each with all of its steps
                    settings = ["--model", model, "--degrade", "false"]
                    one = ServerProcess(settings, ready_timeout_s=options.start_timeout, tell=tell)
                    address, connection = stack.enter_context(one).address, PLAIN
            async with connection.client(address) as client:
                asked = _model(client, model, is_own=options.server is None)
                for column, (name, steps) in enumerate(columns):
                    if name == model:
                        await _fill(page, column, client, asked, steps, options.seed)
                        console.print(f"{names[column]}: done", soft_wrap=True)
    for part, title, animation in evaluated:
        page.add(f"Evaluation: {part}", title, 0, animation.shown())
    write_gallery(options.out, page)
    num_rows = sum(len(rows) for rows in page.parts.values())
    size = options.out.stat().st_size / (1 << 20)
    told = f"wrote {options.out}: {num_rows} rows, {size:.1f} MiB; open it in a browser"
    console.print(told, soft_wrap=True)
    return 0


async def _fill(page: Gallery, column: int, client: MotionClient, model: Model, steps: int | None, seed: int) -> None:
    for answer in await ask_all(client, model, steps, seed):
        page.add(answer.question.part, answer.question.title, column, answer.shown)


def _model(client: MotionClient, name: str, is_own: bool) -> Model:
    """The model of a server started for it, or the one named. Raises UnknownName, which lists the models there are."""
    return client.catalog.models[0] if is_own else client.catalog.model(name)


def _steps(text: str) -> list[int]:
    try:
        steps = [int(part) for part in text.split(",")]
    except ValueError:
        steps = [0]
    if min(steps) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed are whole numbers of 1 or more, as 4 or 4,10")
    return steps
