"""Settings: flags, environment, defaults, and errors that say what is allowed."""

from __future__ import annotations

import re
from dataclasses import fields

import pytest

from motiongen_server.config import SERVER, ServerConfig, parse_config
from motiongen_server.protection import lacks as lacks_of
from motiongen_server.protection import ops_lacks
from motiongen_server.settings import Program, SettingError
from motiongen_server.text.encoder.config import ENCODER, EncoderConfig


def test_help_names_every_flag_and_environment_variable(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parse_config(["--help"], {})
    assert ended.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    for each in fields(ServerConfig):
        assert f"--{each.name.replace('_', '-')} " in text
        assert SERVER.environment_name(each.name) in text.replace(" ", "")


@pytest.mark.parametrize("program", [SERVER, ENCODER])
def test_help_shows_every_setting_under_a_heading_with_its_default(
    program: Program[ServerConfig] | Program[EncoderConfig], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        program.parse(["--help"], {})
    before, *sections = re.split(r"^(?=\S[^\n]*:\n)", capsys.readouterr().out, flags=re.MULTILINE)
    assert "--" not in before.replace("--SETTING", "")
    assert re.findall(r"--\w\S*", sections[0]) == ["--help"]
    text = " ".join(" ".join(sections).split())
    for default in ("(default 127.0.0.1)", "(default false)", "(default none)", "(default 1000)"):
        assert default in text


def test_encoder_service_has_its_own_settings_in_the_same_environment() -> None:
    environment = {
        "MOTIONGEN_PORT": "1111",
        "MOTIONGEN_ENCODER_PORT": "2222",
        "MOTIONGEN_ENCODER_TEXT_ENCODER": "static",
    }
    assert parse_config([], environment).port == 1111
    encoder = ENCODER.parse(["--max-texts", "7"], environment)
    assert (encoder.port, encoder.text_encoder, encoder.max_texts) == (2222, "static", 7)
    with pytest.raises(
        SettingError, match=r"MOTIONGEN_ENCODER_COLOUR.*python -m motiongen_server\.text\.encoder --help"
    ):
        ENCODER.parse([], {"MOTIONGEN_ENCODER_COLOUR": "red"})
    with pytest.raises(SettingError, match=r"port is 70000"):
        ENCODER.parse(["--port", "70000"], {})


def test_settings_of_ports_and_tls_mean_the_same_for_the_server_and_the_encoder_service() -> None:
    server, encoder = ({each.name: each.metadata for each in fields(kind)} for kind in (ServerConfig, EncoderConfig))
    shared = [name for name in server if name in encoder and re.match("host|port|ops_|tls_|insecure|print_ports", name)]
    assert len(shared) == 10
    for name in shared:
        assert {**server[name], "section": ""} == {**encoder[name], "section": ""}, name


@pytest.mark.parametrize("name", ["MOTIONGEN_Port", "MOTIONGEN_port"])
def test_environment_variable_with_wrong_capitals_is_refused(name: str) -> None:
    with pytest.raises(SettingError, match=f"unknown environment settings {name}"):
        parse_config([], {name: "1111"})


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--host", "unix:"], "host is 'unix:'; give the path"),
        (["--ops-host", "unix:/run/ops.sock"], "ops_host is 'unix:/run/ops.sock'; it must be an address"),
        (["--advertise-address", "a:\u0665\u0660"], "advertise_address is 'a:\u0665\u0660'; it must be host:port"),
        (["--admin-listen", "localhost:\u0665"], "admin_listen is 'localhost:\u0665'; it must be a loopback host"),
        (["--admin-listen", "localhost:" + "1" * 5000], "it must be a loopback host and a port"),
    ],
)
def test_invalid_addresses_are_refused(words: list[str], named: str) -> None:
    with pytest.raises(SettingError, match=named):
        parse_config(words, {})


def test_value_that_is_not_utf8_is_refused_by_its_setting() -> None:
    undecodable = b"/models/\xe9".decode("utf-8", "surrogateescape")
    for words, environment in ((["--model", undecodable], {}), ([], {"MOTIONGEN_MODEL": undecodable})):
        with pytest.raises(SettingError, match=r"model is '/models/\\udce9'; it must be text in UTF-8"):
            parse_config(words, environment)


def test_flag_overrides_the_environment_which_overrides_the_default() -> None:
    environment = {"MOTIONGEN_PORT": "1111", "MOTIONGEN_MAX_ROWS": "7", "PATH": "/bin"}
    config = parse_config(["--port", "2222"], environment)
    assert (config.port, config.max_rows, config.ops_port) == (2222, 7, ServerConfig().ops_port)


@pytest.mark.parametrize(
    ("words", "value"),
    [(["--print-ports"], True), (["--print-ports", "no"], False), (["--print-ports=TRUE"], True), ([], False)],
)
def test_switches_are_read_with_and_without_a_value(words: list[str], value: bool) -> None:
    assert parse_config(words, {}).print_ports is value


@pytest.mark.parametrize("name", [each.name for each in fields(ServerConfig) if each.metadata["least"] is not None])
def test_value_out_of_range_is_refused_with_the_range(name: str) -> None:
    metadata = {each.name: each.metadata for each in fields(ServerConfig)}[name]
    for bound, step in ((metadata["least"], -1), (metadata["most"], 1)):
        with pytest.raises(SettingError) as refused:
            parse_config([f"--{name.replace('_', '-')}={bound + step}"], {})
        words = str(refused.value).replace(";", " ").split()
        assert name in words
        assert [float(word) for word in (words[-3], words[-1])] == [metadata["least"], metadata["most"]]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--port", "many"], ["port", "'many'", "whole number"]),
        (["--port", "1.5"], ["port", "'1.5'", "whole number"]),
        (["--flush-ms", "nan"], ["flush_ms", "nan", "1 to 1000"]),
        (["--idle-timeout-s", "soon"], ["idle_timeout_s", "'soon'", "a number"]),
        (["--reflection", "perhaps"], ["reflection", "'perhaps'", "true or false"]),
        (["--devices", "abacus"], ["devices", "'abacus'", "cuda:all", "cpu:2x4"]),
        (["--lookahead-frames", "100"], ["max_lookahead_frames", "100"]),
        (["--colour", "red"], ["--colour", "--help"]),
        (["--port"], ["--port", "--help"]),
    ],
)
def test_invalid_values_are_refused_by_setting(words: list[str], expected: list[str]) -> None:
    with pytest.raises(SettingError) as refused:
        parse_config(words, {})
    for part in expected:
        assert part in str(refused.value)
    assert "\n" not in str(refused.value)


def test_invalid_environment_values_are_refused() -> None:
    with pytest.raises(SettingError, match=r"port is 70000; it must be from 0 to 65535"):
        parse_config([], {"MOTIONGEN_PORT": "70000"})


def test_unknown_environment_variable_is_refused() -> None:
    with pytest.raises(SettingError, match=r"MOTIONGEN_PROT.*--help"):
        parse_config([], {"MOTIONGEN_PROT": "1"})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("MOTIONGEN_SERVICE_HOST", "10.0.0.7"),
        ("MOTIONGEN_SERVICE_PORT", "50051"),
        ("MOTIONGEN_SERVICE_PORT_GRPC", "50051"),
        ("MOTIONGEN_PORT", "tcp://10.0.0.7:50051"),
        ("MOTIONGEN_OPS_PORT", "tcp://10.0.0.8:9464"),
        ("MOTIONGEN_PORT_50051_TCP", "tcp://10.0.0.7:50051"),
        ("MOTIONGEN_PORT_50051_TCP_ADDR", "10.0.0.7"),
        ("MOTIONGEN_WEST_SERVICE_HOST", "10.0.0.9"),
        ("MOTIONGEN_WEST_PORT", "tcp://10.0.0.9:50051"),
    ],
)
def test_variables_kubernetes_sets_for_a_service_are_ignored(name: str, value: str) -> None:
    assert parse_config([], {name: value}) == ServerConfig()


@pytest.mark.parametrize("name", ["MOTIONGEN_WEST_PORT", "MOTIONGEN_SERVICE", "MOTIONGEN_PORT_X_TCP"])
def test_variables_that_only_resemble_those_of_kubernetes_are_refused(name: str) -> None:
    with pytest.raises(SettingError, match=name):
        parse_config([], {name: "5"})


def test_default_lookahead_covers_the_horizon() -> None:
    assert [ServerConfig().lookahead_for(horizon) for horizon in (8, 40, 52)] == [40, 40, 52]
    assert ServerConfig(lookahead_frames=60).lookahead_for(52) == 60
    most = ServerConfig(max_lookahead_frames=30)
    assert [most.lookahead_for(horizon) for horizon in (8, 30)] == [30, 30], (
        "the default is lowered to max_lookahead_frames, not refused"
    )


@pytest.mark.parametrize("words", [["--model", "one", "--model", "two"], ["--model", "one, two"]])
def test_several_models_are_given_by_repetition_or_commas(words: list[str]) -> None:
    assert parse_config(words, {}).models == ("one", "two")
    assert parse_config([], {"MOTIONGEN_MODEL": "one,two"}).models == ("one", "two")
    assert parse_config(words, {"MOTIONGEN_MODEL": "three"}).models == ("one", "two")


@pytest.mark.parametrize("address", ["127.0.0.1:0", "localhost:50052", "[::1]:50052", "unix:admin.sock"])
def test_admin_service_may_listen_on_local_addresses(address: str) -> None:
    assert ServerConfig(admin_listen=address).admin_listen == address


@pytest.mark.parametrize(
    "address", ["0.0.0.0:50052", "10.0.0.7:50052", ":50052", "localhost", "localhost:70000", "unix:"]
)
def test_admin_service_may_not_listen_on_other_addresses(address: str) -> None:
    with pytest.raises(SettingError, match="it must be a loopback host"):
        ServerConfig(admin_listen=address)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"model": "one,one"}, "give each model once"),
        ({"model": "one,,two"}, "give each model once"),
        ({"devices": "cpu:0"}, "1 to 64 engines"),
    ],
)
def test_invalid_combinations_of_models_and_devices_are_refused(settings: dict[str, object], named: str) -> None:
    with pytest.raises(SettingError, match=named):
        ServerConfig(**settings)  # type: ignore[arg-type]


TLS = {"tls_certificate": "a.pem", "tls_key": "a.key"}


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.8.8", "localhost", "::1"])
def test_local_addresses_need_no_tls_or_authentication(host: str) -> None:
    assert ServerConfig(host=host, ops_host=host).host == host
    assert ServerConfig(host="unix:motion.sock", ops_host=host).host == "unix:motion.sock"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "10.0.0.7", "motion.example", ""])
@pytest.mark.parametrize(
    ("protection", "lacks"),
    [
        ({}, r"without TLS \(--tls-certificate, --tls-key\) and without authentication of callers"),
        (TLS, "without authentication of callers"),
        ({"tenants": "tenants.toml"}, "without TLS"),
    ],
)
def test_public_address_needs_tls_and_authentication_unless_insecure(
    host: str, protection: dict[str, str], lacks: str
) -> None:
    with pytest.raises(SettingError, match=f"^host is {host!r}.*{lacks}.*--insecure"):
        ServerConfig(host=host, **protection)  # type: ignore[arg-type]
    assert lacks_of(ServerConfig(host=host, insecure=True, **protection))  # type: ignore[arg-type]


@pytest.mark.parametrize("who", [{"tenants": "tenants.toml"}, {"tls_client_ca": "ca.pem"}])
def test_public_address_with_tls_and_authentication_is_allowed(who: dict[str, str]) -> None:
    assert lacks_of(ServerConfig(host="0.0.0.0", **TLS, **who)) == ()  # type: ignore[arg-type]


def test_metrics_on_a_public_address_need_tenants() -> None:
    with pytest.raises(SettingError, match=r"^ops_host is '0\.0\.0\.0'.*without authentication for the metrics"):
        ServerConfig(ops_host="0.0.0.0")
    assert ops_lacks(ServerConfig(ops_host="0.0.0.0", tenants="tenants.toml")) == ()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"tls_certificate": "a.pem"}, "must be given together"),
        ({"tls_key": "a.key"}, "must be given together"),
        ({"tls_client_ca": "ca.pem"}, "without tls_certificate"),
        ({"ops_tls": True}, "without tls_certificate"),
    ],
)
def test_inconsistent_tls_settings_are_refused(settings: dict[str, str], said: str) -> None:
    with pytest.raises(SettingError, match=said):
        ServerConfig(**settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"text_encoder": "grpc:encoder:1", "text_encoder_ca": "ca.pem"}, "only grpcs:HOST:PORT is reached by TLS"),
        ({"text_encoder_ca": "ca.pem"}, "text_encoder is 'static'; only grpcs:"),
        (
            {"text_encoder": "gradio:http://encoder", "text_encoder_token": "token"},
            "sent to grpc:HOST:PORT and grpcs:",
        ),
    ],
)
def test_encoder_credentials_that_its_address_cannot_use_are_refused(settings: dict[str, str], said: str) -> None:
    with pytest.raises(SettingError, match=said):
        ServerConfig(**settings)  # type: ignore[arg-type]
    both = ServerConfig(text_encoder="grpcs:encoder:1", text_encoder_ca="ca.pem", text_encoder_token="token")
    assert both.text_encoder_token
