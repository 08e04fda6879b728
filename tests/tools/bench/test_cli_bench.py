"""`motiongen bench` as a user runs it: against the real server without a model, with processes of its own."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from motiongen_client.errors import ServerUnavailable
from motiongen_tools import cli_bench
from motiongen_tools.bench.load import Load
from motiongen_tools.bench.result import Result
from motiongen_tools.bench.scenario import load_scenario
from motiongen_tools.cli import run
from motiongen_tools.cli_bench import VOID, num_processes
from motiongen_tools.server_process import ServerFailed
from tests.attack.server import attacked
from tests.server.identity.files import AUTHORITY, CERTIFICATES, TenantsFile, copy_pair
from tests.tools.bench.made_up import make_result

NEVER_VOID = ["--max-lag-ms", "60000"]  # the machine that runs the tests may be slow


def test_a_run_with_two_processes_plays_the_schedule_and_is_reported(
    null_server: str, short_scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    load = ["--server", null_server, "--scenario", str(short_scenario), "--seconds", "1", "--seed", "4"]
    code = run(["bench", *load, "--processes", "2", "--out", str(out), *NEVER_VOID])
    printed = capsys.readouterr().out
    assert code == 0, printed
    result = json.loads((out / "result.json").read_text())["result"]
    schedule = Load("", load_scenario(str(short_scenario)), 6, 1, seed=4).schedule()
    assert result["load"]["schedule_sha256"] == schedule.sha256()
    assert result["load"]["processes"] == len(result["generator"]["cores"]) == 2
    assert sum(result["by_second"]["edits"]) == len(schedule.edit_at_s)
    assert 6 <= result["counts"]["sessions_opened"] <= len(schedule.characters)  # the last may come too late
    assert result["server"]["model"] == "null"
    assert result["void"] == []
    assert not [name for name in result["counts"] if name.startswith(("refused", "stream", "protocol"))]
    assert result["latencies_ms"]["open_to_first_frame"]["all"]["count"] == len(schedule.characters)
    assert "event to first changed frame" in printed
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "report.png", "result.json"]


def test_a_server_with_tls_and_tenants_can_be_loaded(
    short_scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tenants, token = TenantsFile(tmp_path), tmp_path / "token"
    token.write_text(tenants.one())
    certificate, key = copy_pair("server-1", tmp_path)
    settings = ("--tls-certificate", certificate, "--tls-key", key, "--tls-client-ca", AUTHORITY,
                "--tenants", str(tenants.path))  # fmt: skip
    with attacked(tmp_path / "log", settings) as server:
        load = ["--server", server.address, "--scenario", str(short_scenario), "--seconds", "1", "--seed", "4"]
        load += ["--connect-timeout", "60"]
        shown = ["--tls-certificate", str(CERTIFICATES / "client.pem"), "--tls-key", str(CERTIFICATES / "client.key")]
        words = ["bench", *load, "--out", str(tmp_path / "out"), *NEVER_VOID, "--tls-ca", AUTHORITY, *shown]
        unknown = ["--tls-ca", AUTHORITY, "--token-file", str(token), "--connect-timeout", "1"]
        assert run(words) == 1
        assert "CREDENTIALS_INVALID" in capsys.readouterr().err, "its certificate is valid, but of no tenant"
        assert run([*words, "--token-file", str(token)]) == 0
        assert run(["catalog", "--server", server.address, *unknown]) == 1
        assert run([*words, "--tls-key", str(tmp_path / "nowhere")]) == 1
        assert "tls-key" in capsys.readouterr().err


def test_a_certificate_without_its_key_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["demo", "--server", "localhost:1", "--out", str(tmp_path), "--tls-certificate", "a.pem"]
    assert run(words) == 1
    assert "--tls-key together" in capsys.readouterr().err


@pytest.fixture
def simulated_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs that are only simulated: 20 characters are served in full, and from 100 on the generator is late."""

    async def run_load(load: Load, *_: object) -> Result:
        missed, lag_ms = 0 if load.characters <= 20 else 500, 0.5 if load.characters < 100 else 50.0
        return make_result(characters=load.characters, missed=missed, lag_ms=lag_ms)

    monkeypatch.setattr(cli_bench, "run_load", run_load)
    monkeypatch.setattr(cli_bench, "REST_S", 0)


@pytest.mark.usefixtures("simulated_runs")
def test_a_run_with_a_late_generator_is_void(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench", "--characters", "100", "--out", str(tmp_path)]) == VOID
    assert "VOID: the generator's send lag was" in capsys.readouterr().out


@pytest.mark.usefixtures("simulated_runs")
def test_the_largest_number_of_characters_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bench", "--find", "--characters", "9", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "20 characters are served in full." in printed
    assert "36 characters, 5 s: 50.00% of frames missed" in printed
    assert json.loads((tmp_path / "result.json").read_text())["search"]["characters"] == 20
    assert (tmp_path / "search.png").is_file()


class Dies:
    """A server that is killed while it is measured."""

    address, ops_address, pid = "localhost:1", "localhost:2", 1

    def __init__(self, *_: object, **__: object) -> None:
        """Takes what a server that is started takes."""

    def __enter__(self) -> Dies:
        return self

    def __exit__(self, *_: object) -> None:
        raise ServerFailed("the server ended with exit code -9, not 0", "")


@pytest.mark.usefixtures("simulated_runs")
def test_what_was_measured_is_reported_although_the_server_died(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli_bench, "ServerProcess", Dies)
    assert run(["bench", "--start-server", "--characters", "50", "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    assert "Not served in full: 50.00% of frames were missed" in printed.out
    assert "error: the server ended with exit code -9, not 0" in printed.err
    assert (tmp_path / "result.json").is_file()


def test_a_search_whose_server_is_gone_reports_the_trials_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async def run_load(load: Load, *_: object) -> Result:
        if load.characters > most:
            raise ServerUnavailable("localhost:1", "it is gone")
        return make_result(characters=load.characters)

    monkeypatch.setattr(cli_bench, "run_load", run_load)
    most = 20
    assert run(["bench", "--find", "--characters", "8", "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    assert "16 characters are served in full, as far as was found out before a run failed; that was" in printed.out
    assert printed.err.startswith("error: no motiongen server answers at localhost:1: it is gone")
    written = json.loads((tmp_path / "result.json").read_text())["search"]
    assert [trial["characters"] for trial in written["trials"]] == [8, 16]
    assert "it is gone" in written["failure"]
    most = 0
    assert run(["bench", "--find", "--characters", "8", "--out", str(tmp_path / "none")]) == 1
    assert not (tmp_path / "none").exists()


def test_numbers_of_steps_that_the_model_cannot_do_are_refused(
    null_server: str, short_scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    load = ["--server", null_server, "--scenario", str(short_scenario), "--steps", "99"]
    assert run(["bench", *load, "--out", str(tmp_path)]) == 1
    assert "99 was given; allowed is 2 to 10, which is what null can do" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--server", "localhost:1", "--connect-timeout", "0.2"], 1, "no motiongen server answers at localhost:1"),
        (["--scenario", "crowds"], 1, "no scenario is called 'crowds'"),
        (["--seconds", "0"], 2, "'0' was given; allowed is a whole number of 1 or more"),
        (["--seconds", "1000001"], 2, "allowed is a whole number of 1 or more, up to 1,000,000"),
        (["--trial-seconds", "1000001"], 2, "allowed is a whole number of 1 or more, up to 1,000,000"),
        (["--characters", "1000001"], 2, "allowed is a whole number of 1 or more, up to 1,000,000"),
        (["--processes", "1025"], 2, "allowed is a whole number of 1 or more, up to 1,024"),
        (["--max-misses", "-1"], 2, "'-1' was given; allowed is a number above 0"),
        (["--", "--denoise-steps", "10"], 2, "is for a server that this starts: give --start-server too"),
        (["--server", "localhost:1", "--start-server"], 2, "not allowed with argument"),
    ],
)
def test_invalid_arguments_are_reported(
    arguments: list[str], code: int, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["bench", "--out", str(tmp_path), *arguments]) == code
    assert message in capsys.readouterr().err


def test_a_report_that_cannot_be_written_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    assert run(["bench", "--server", "localhost:1", "--out", str(tmp_path / "file")]) == 1
    assert f"allowed is a folder: {tmp_path / 'file'} is not one" in capsys.readouterr().err
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "hdrh" else object())
    assert run(["bench", "--server", "localhost:1", "--out", str(tmp_path)]) == 1
    assert "motiongen bench needs hdrhistogram: install it with `pip install" in capsys.readouterr().err


def test_processes_grow_with_the_characters_up_to_half_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    assert [num_processes(characters) for characters in (1, 2000, 2001, 100_000)] == [1, 1, 2, 4]
    monkeypatch.setattr("os.cpu_count", lambda: 1)
    assert num_processes(100_000) == 1
