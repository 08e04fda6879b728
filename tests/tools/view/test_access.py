"""Access to the viewer: roles by token, host names, and the origins of pages."""

from __future__ import annotations

import pytest

from motiongen_tools.view.access import Access, Role, is_loopback, is_own_page


def test_a_token_is_required_unless_listening_at_loopback() -> None:
    assert Access.to_listen_at("127.0.0.1").role_of("") is Role.CONTROL
    open_to_others = Access.to_listen_at("0.0.0.0")
    assert open_to_others.role_of("") is None
    assert open_to_others.role_of("guess") is None
    assert Access.to_listen_at("localhost", wants_token=True).role_of("") is None


def test_each_token_has_its_role() -> None:
    access = Access("steer", "look")
    assert access.role_of("steer") is Role.CONTROL
    assert access.role_of("look") is Role.WATCH
    assert access.role_of("stéér") is None


def test_tokens_are_random_and_not_in_the_repr() -> None:
    first, second = Access.to_listen_at("::"), Access.to_listen_at("::")
    assert first.control_token
    assert first.control_token not in (second.control_token, first.watch_token)
    assert first.control_token not in repr(first)


@pytest.mark.parametrize(
    ("host", "admitted"),
    [
        ("localhost:8321", True),
        ("127.0.0.1:1", True),
        ("[::1]:8321", True),
        ("evil.example:8321", False),
        ("", False),
        ("[", False),
        ("[::1", False),
    ],
)
def test_without_tokens_only_host_names_of_this_machine_are_admitted(host: str, admitted: bool) -> None:
    assert Access().admits_host(host) is admitted
    assert Access("steer", "look").admits_host(host)


def test_only_our_page_and_programs_may_open_sockets() -> None:
    assert is_own_page("http://localhost:8321", "localhost:8321")
    assert is_own_page(None, "localhost:8321")
    assert not is_own_page("http://evil.example", "localhost:8321")
    assert not is_own_page("http://localhost:9999", "localhost:8321")
    assert not is_own_page("null", "localhost:8321")
    assert not is_own_page("http://[", "localhost:8321")
    assert not is_own_page("null", "")


@pytest.mark.parametrize(
    ("site", "ours"), [("same-origin", True), ("none", True), ("same-site", False), ("cross-site", False), ("?", False)]
)
def test_without_an_origin_the_site_decides_whose_page_asks(site: str, ours: bool) -> None:
    assert is_own_page(None, "localhost:8321", site) is ours


@pytest.mark.parametrize("host", ["192.168.1.4", "0.0.0.0", "::", "example.org"])
def test_addresses_that_others_can_reach_are_not_loopback(host: str) -> None:
    assert not is_loopback(host)
