"""The command line: what it understands, what it refuses and how it says so, and what it writes."""

from __future__ import annotations

import asyncio
import builtins
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import grpc
import pytest

from motiongen_ardy.data.bvh import read_bvh
from motiongen_client import MissingExtra
from motiongen_tools.cli import parse, run
from motiongen_tools.cli_stream import TimedWaypoint
from motiongen_tools.console import make_console
from motiongen_tools.npz import read_npz
from tests.client.fake_server import FakeServer
from tests.client.synthetic import catalog
from tests.waiting import until_true


def test_a_prompt_starts_at_the_time_given_before_it() -> None:
    options = parse(["stream", "--prompt", "walk", "--at", "4", "--prompt", "run", "--at", "6.5", "--prompt", "sit"])
    assert options.script.prompts == [(0.0, "walk"), (4.0, "run"), (6.5, "sit")]
    assert options.server == "localhost:50051"


def test_the_first_prompt_may_start_later() -> None:
    assert parse(["stream", "--at", "2", "--prompt", "run"]).script.prompts == [(2.0, "run")]


def test_waypoints_have_a_place_a_time_and_an_optional_heading() -> None:
    options = parse(["stream", "--waypoint", "0.5,4@3", "--waypoint=-1,2,1.57@5"])
    assert options.waypoint == [TimedWaypoint(3.0, 0.5, 4.0), TimedWaypoint(5.0, -1.0, 2.0, 1.57)]


def test_generate_accepts_a_timeline_and_settings_of_its_server() -> None:
    line = ["generate", "walk", "--at", "2", "--prompt", "run", "--out", "a.npz", "--out", "b.glb", "--start-server"]
    options = parse([*line, "--", "--model", "g1"])
    assert options.script.prompts == [(0.0, "walk"), (2.0, "run")]
    assert options.out == [Path("a.npz"), Path("b.glb")]
    assert options.server_arguments == ["--model", "g1"]
    assert options.start_timeout is None, "the first start of a model takes as long as the download of its weights"


@pytest.mark.parametrize(
    "command",
    ["generate walk --start-server", "bench --start-server", "view --start-server", "gallery motiongen-mini", "demo"],
)
def test_commands_that_start_a_server_accept_a_start_timeout(command: str) -> None:
    assert parse([*command.split(), "--start-timeout", "30"]).start_timeout == 30


@pytest.mark.parametrize(("given", "file"), [("walk.bvh", "walk.bvh"), ("out/walk", "out/walk.bvh")])
def test_the_output_of_stream_is_a_bvh_file(given: str, file: str) -> None:
    assert parse(["stream", "--prompt", "walk", "--out", given]).out == Path(file)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ("stream", "nothing to do: give a --prompt, a --waypoint or both"),
        ("stream --prompt walk --prompt run", "a second prompt needs --at SECONDS before it"),
        ("stream --prompt walk --at 3", "--at 3 has no --prompt after it"),
        ("stream --at 1 --at 2 --prompt walk", "--at 1 has no --prompt after it"),
        ("stream --at 3 --prompt walk --at 2 --prompt run", "times must rise; the prompt before it is at 3 s"),
        ("stream --prompt walk --at 9 --prompt run", "9 s is not before the end, which is at --seconds 8"),
        ("stream --prompt walk --at soon --prompt run", "'soon' was given; allowed is a number of seconds"),
        ("stream --prompt walk --at -1 --prompt run", "'-1' was given; allowed is a number of seconds"),
        ("stream --waypoint 1@2", "'1@2' was given; allowed is x,z@seconds"),
        ("stream --waypoint 1,2", "allowed is x,z@seconds"),
        ("stream --waypoint 1,nan@2", "allowed is x,z@seconds"),
        ("stream --waypoint 1,2@8", "--waypoint: 8 s is not before the end"),
        ("stream --prompt walk --seconds 0", "'0' was given; allowed is a number of seconds above 0"),
        ("stream --prompt walk --seconds inf", "'inf' was given"),
        ("stream --prompt walk --out walk.fbx", "'walk.fbx' was given; allowed is a name that ends in .bvh"),
        ("stream --prompt walk --seed -1", "'-1' was given; allowed is a whole number of 0 or more, up to 18,446,744"),
        ("stream --prompt walk --steps 0", "'0' was given; allowed is a whole number of 1 or more"),
        ("stream --prompt walk --steps " + "9" * 5000, "allowed is a whole number of 1 or more"),
        ("generate walk --seed 18446744073709551616", "'18446744073709551616' was given"),
        ("generate", "nothing to do: give a PROMPT, --waypoint, --constraints or --history"),
        ("generate walk --prompt run", "PROMPT and a --prompt without --at before it are both for the start"),
        ("generate walk --at 3", "--at 3 has no --prompt after it"),
        ("generate walk --at 9 --prompt run", "9 s is not before the end, which is at --seconds 6"),
        ("generate walk --out walk.fbx", "allowed is a name that ends in .controller.csv, .csv, .npz"),
        ("generate walk --out .npz", "allowed is a name that ends in"),
        ("generate walk --samples 0", "allowed is a whole number of 1 or more"),
        ("generate walk -- --model g1", "'--model' is for a server that this starts: give --start-server too"),
        ("generate walk --start-server --server a:1", "not allowed with argument"),
        ("generate walk --start-timeout 5", "--start-timeout is for a server that this starts: give --start-server"),
        ("demo --server a:1 --start-timeout 5", "--start-timeout is for a server that this starts: leave --server out"),
        ("gallery mini --token-file t", "--token-file is for a server that is running"),
        ("demo --tls", "--tls is for a server that is running"),
        ("view --start-server --tls-ca ca.pem", "--tls-ca is for a server that is running"),
        ("bench --find-within 60", "--find-within is for a search: give --find too"),
        ("bench --trial-seconds 5", "--trial-seconds is for a search: give --find too"),
        ("dance", "invalid choice: 'dance'"),
        ("stream --prompt caf\udce9", "'caf\\udce9' is not valid UTF-8 text"),
        ("stream --prompt walk --out caf\udce9.bvh", "is not valid UTF-8 text"),
    ],
)
def test_invalid_arguments_are_reported(arguments: str, complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(arguments.split()) == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize("command", ["", "stream", "catalog", "demo"])
def test_help_exits_with_0(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*command.split(), "--help"]) == 0
    assert "usage: motiongen" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["catalog", "stream --prompt walk"])
def test_an_unreachable_server_is_reported_without_a_traceback(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([*command.split(), "--server", "127.0.0.1:1", "--connect-timeout", "0.2"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: no motiongen server answers at 127.0.0.1:1")
    assert "Traceback" not in error


async def command(*arguments: str) -> int:
    """Run a command in a thread: it makes an event loop of its own."""
    return await asyncio.to_thread(run, arguments)


async def test_stream_writes_the_requested_files(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "walk"
    script = ["--prompt", "walk", "--at", "1", "--prompt", "run", "--waypoint", "1,2.5@0.5", "--seed", "5"]
    files = ["--seconds", "2", "--out", str(out), "--npz", "--png"]
    assert await command("stream", "--server", server.address, *script, *files) == 0
    assert read_bvh(out.with_suffix(".bvh")).num_frames == 200
    assert read_npz(out.with_suffix(".npz")).rig.rig_id == "stick9"
    assert out.with_suffix(".png").stat().st_size > 5000
    opened = server.stream.received[0].open
    assert [(span.start_frame, span.text) for span in opened.prompts] == [(0, "walk"), (100, "run")]
    assert (opened.constraints[0].frame, opened.seed) == (50, 5)
    printed = capsys.readouterr().out
    assert "200 frames, 2.00 s" in printed
    assert "waypoint 1, 2.5 at frame 50" in printed
    assert "CC0-1.0" in printed


async def test_times_round_down_to_a_frame_and_brackets_in_file_names_are_shown(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "walk[b].bvh"
    script = ["--prompt", "walk", "--waypoint", "1,2@0.999", "--seconds", "1"]
    assert await command("stream", "--server", server.address, *script, "--out", str(out)) == 0
    printed = capsys.readouterr().out
    assert "at frame 99" in printed
    assert f"wrote {out}" in printed


@pytest.mark.parametrize("asked", ["stream --prompt walk --out {}.bvh", "generate walk --out {}.npz --samples 2"])
def test_output_that_cannot_be_written_is_refused_before_the_work(
    asked: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("no folder")
    command = asked.format(tmp_path / "file" / "walk").split()
    assert run([*command, "--server", "127.0.0.1:1", "--connect-timeout", "0.2"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: --out: ")
    assert error.endswith(f"allowed is a folder: {tmp_path / 'file'} is not one\n")


@pytest.mark.parametrize(
    "asked", ["stream --prompt walk --out {}/a/b.bvh", "generate walk --out {}/a/b.npz --samples 2"]
)
def test_failed_command_leaves_no_folder_behind(asked: str, tmp_path: Path) -> None:
    assert run([*asked.format(tmp_path).split(), "--server", "127.0.0.1:1", "--connect-timeout", "0.2"]) == 1
    assert not any(tmp_path.iterdir())


def test_an_os_error_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def fill_the_disk(options: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("motiongen_tools.cli_catalog.catalog", fill_the_disk)
    assert run(["catalog"]) == 1
    assert capsys.readouterr().err == "error: [Errno 28] No space left on device\n"


async def test_catalog_lists_models_rigs_and_limits(server: FakeServer, capsys: pytest.CaptureFixture[str]) -> None:
    assert await command("catalog", "--server", server.address) == 0
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("synthetic", "stick9", "2.5 M", "max_prompts", "CC0-1.0"))


async def test_texts_with_markup_are_shown_literally(
    server: FakeServer, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    offered = catalog(100)
    offered.models[0].licence = "[/red] [bold]CC0 :car:"
    monkeypatch.setattr("tests.client.fake_server.catalog", lambda _: offered)
    monkeypatch.setenv("COLUMNS", "300")
    assert await command("catalog", "--server", server.address) == 0
    assert "[/red] [bold]CC0 :car:" in capsys.readouterr().out


async def test_an_unknown_model_is_refused_with_the_known_ones(
    server: FakeServer, capsys: pytest.CaptureFixture[str]
) -> None:
    assert await command("stream", "--server", server.address, "--prompt", "walk", "--model", "big") == 1
    assert "no model is called 'big'; known are: synthetic" in capsys.readouterr().err


async def test_clip_longer_than_the_limit_is_refused_in_seconds(
    server: FakeServer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "walk.npz")]
    assert await command("generate", "walk", "--server", server.address, "--seconds", "100000", *out) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: --seconds: 100000.0 was given; allowed is at most ")


async def test_a_server_that_does_not_come_back_ends_the_command(
    server: FakeServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("motiongen_tools.connection.RECOVER_S", 0)
    script = ["--prompt", "walk", "--seconds", "100000", "--realtime", "--out", str(tmp_path / "walk.bvh")]
    running = asyncio.create_task(command("stream", "--server", server.address, *script))
    await until_true(lambda: server.streams and server.stream.received)
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)
    assert await running == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: ")


@pytest.mark.parametrize(
    ("line", "server", "token"),
    [
        ("admin list", "localhost:50052", None),
        ("admin --server a:1 list", "a:1", None),
        ("admin list --server a:1 --token-file t", "a:1", Path("t")),
        ("admin --server a:1 --token-file t load g1", "a:1", Path("t")),
        ("admin unload g1 --grace 3 --server a:1", "a:1", None),
    ],
)
def test_options_of_admin_may_precede_or_follow_the_action(line: str, server: str, token: Path | None) -> None:
    options = parse(line.split())
    assert (options.server, options.token_file) == (server, token)


async def test_a_refusal_by_the_server_is_reported_as_an_error(
    server: FakeServer, capsys: pytest.CaptureFixture[str]
) -> None:
    server.refuse = lambda event: "BLANK_PROMPT" if event.WhichOneof("event") == "open" else ""
    assert await command("stream", "--server", server.address, "--prompt", " ") == 1
    assert capsys.readouterr().err.startswith("error: opening a session was refused with BLANK_PROMPT")


def test_a_missing_extra_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def without_rich(name: str, *rest: Any) -> Any:
        if name.startswith("rich"):
            raise ImportError(name)
        return original(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_rich)
    with pytest.raises(MissingExtra, match=r"the command line needs rich: .*`pip install rich`"):
        make_console()


@pytest.mark.parametrize("deed", ["unload", "reload"])
def test_an_invalid_grace_is_reported_as_an_error(deed: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["admin", deed, "g1", "--grace", "1e300", "--server", "localhost:1"]) == 1
    assert capsys.readouterr().err.startswith("error: grace_s: 1e+300 was given; allowed is seconds from 0")


SAYS_MORE_THAN_ASCII = """
import sys
from motiongen_tools import cli, cli_catalog
from motiongen_tools.console import make_console

async def catalog(options):
    make_console().print("wrote caf\\xe9.bvh")
    return 0

cli_catalog.catalog = catalog
sys.exit(cli.run(["catalog"]))
"""


def test_characters_that_the_terminal_cannot_show_are_escaped() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SAYS_MORE_THAN_ASCII],
        env={**os.environ, "PYTHONIOENCODING": "ascii"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "wrote caf\\xe9.bvh\n", "")
