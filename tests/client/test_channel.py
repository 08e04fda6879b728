"""The channel of a client: which addresses, tokens and metadata are accepted, and what is not sent."""

from __future__ import annotations

import grpc
import grpc.aio
import pytest

from motiongen_client import MotionClient, blocking
from motiongen_client.admin import AdminClient
from motiongen_client.channel import OPTIONS, ChannelSettings
from motiongen_client.errors import InvalidInput
from tests.client.fake_server import FakeServer

TLS = grpc.ssl_channel_credentials()


@pytest.mark.parametrize("address", ["localhost:1", "127.0.0.1:1", "[::1]:1", "unix:motion.sock"])
def test_token_without_tls_is_allowed_to_a_local_address(address: str) -> None:
    assert ChannelSettings(address, token="secret").credentials is None


@pytest.mark.parametrize("address", ["10.0.0.7:50051", "motion.example:50051"])
def test_token_without_tls_is_refused_to_a_remote_address(address: str) -> None:
    with pytest.raises(InvalidInput, match="credentials"):
        MotionClient(address, token="secret")
    with pytest.raises(InvalidInput, match="credentials"):
        blocking.MotionClient(address, token=lambda: "secret")
    with pytest.raises(InvalidInput, match="credentials"):
        AdminClient(address, token="secret")
    assert ChannelSettings(address, TLS, "secret").token == "secret"


@pytest.mark.parametrize("token", ["", "two words", "line\n", "é"])
def test_invalid_token_is_refused_and_no_token_is_printed(token: str) -> None:
    with pytest.raises(InvalidInput, match="token") as refused:
        ChannelSettings("localhost:1", token=token)
    assert not token or token not in str(refused.value)
    assert "secret" not in repr(ChannelSettings("localhost:1", token="secret"))


def test_authorization_metadata_is_refused_in_favour_of_token() -> None:
    with pytest.raises(InvalidInput, match="token="):
        ChannelSettings("motion.example:1", metadata=[("authorization", "Bearer secret")])


def test_token_in_plain_text_is_not_sent_through_a_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, object]] = []
    monkeypatch.setattr("grpc.aio.insecure_channel", lambda address, options: seen.append(dict(options)))
    ChannelSettings("localhost:1").open()
    ChannelSettings("localhost:1", token="secret").open()
    assert [options.get("grpc.enable_http_proxy") for options in seen] == [None, 0]
    with pytest.raises(InvalidInput, match="proxy"):
        ChannelSettings("localhost:1", token="secret", options=[("grpc.enable_http_proxy", 1)])


def test_ipv6_address_with_an_ambiguous_port_is_refused() -> None:
    with pytest.raises(InvalidInput, match=r"\[::1\]:5005"):
        ChannelSettings("::1:5005", token="secret")


@pytest.mark.parametrize("pair", [("Upper", "x"), ("grpc-timeout", "x"), ("a-bin", "x"), ("a", "x\n"), ("", "x")])
def test_invalid_metadata_is_refused(pair: tuple[str, str]) -> None:
    with pytest.raises(InvalidInput, match="metadata"):
        ChannelSettings("localhost:1", metadata=[pair])


async def test_token_metadata_and_options_reach_grpc(server: FakeServer, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, object] = {}
    make = grpc.aio.insecure_channel

    def insecure_channel(address: str, options: list[tuple[str, object]]) -> grpc.aio.Channel:
        seen.update(options)
        return make(address, options=options)  # type: ignore[arg-type]

    monkeypatch.setattr("grpc.aio.insecure_channel", insecure_channel)
    options = [("grpc.max_receive_message_length", 1 << 24)]
    tokens = iter(["one", "two", "three", "four"])
    line = {"metadata": [("x-route", "blue")], "channel_options": options, "token": lambda: next(tokens)}
    async with MotionClient(server.address, **line) as client, await client.open("a person walks"):  # type: ignore[arg-type]
        pass
    assert seen == dict(OPTIONS) | dict(options) | {"grpc.enable_http_proxy": 0}
    assert [heard["authorization"] for heard in server.metadata[:2]] == ["Bearer one", "Bearer two"]
    assert all(heard["x-route"] == "blue" for heard in server.metadata)


@pytest.mark.parametrize("address", ["a:²", "a:" + "1" * 5000, "a\udcff:1", "unix:/a\udcff", "a\0:1"])
def test_malformed_address_is_refused_with_the_allowed_form(address: str) -> None:
    with pytest.raises(InvalidInput, match="allowed is host:port"):
        ChannelSettings(address)


@pytest.mark.parametrize("address", ["http://localhost:50051", "grpc://localhost:50051"])
def test_an_address_with_a_scheme_is_refused_with_what_to_give(address: str) -> None:
    with pytest.raises(InvalidInput, match=r"allowed is host:port without a scheme: localhost:50051$"):
        ChannelSettings(address)
