"""`motiongen-server-ready`: whether the server, or with `--encoder` the text encoder, on this machine is ready.

For health checks of containers and supervisors. It reads the same environment variables as the program that it checks.
Exit code 0: ready; 1: not ready; 2: an invalid setting.
"""

from __future__ import annotations

import argparse
import http.client
import ssl
import sys
import urllib.request
from collections.abc import Mapping, Sequence
from typing import Protocol

from motiongen_server.addresses import join_address
from motiongen_server.config import SERVER
from motiongen_server.settings import SettingError
from motiongen_server.text.encoder.config import ENCODER

TIMEOUT_S = 2.0
EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}
"""An address that stands for all addresses of a machine -> the one by which it reaches itself."""


class OpsSettings(Protocol):
    """These settings, of either program."""

    @property
    def ops_host(self) -> str: ...

    @property
    def ops_port(self) -> int: ...

    @property
    def ops_tls(self) -> bool: ...


def readiness_url(config: OpsSettings) -> str:
    """The URL of a program's readiness, as seen from its own machine. Raises SettingError if its port is not fixed."""
    if config.ops_port == 0:
        raise SettingError("ops_port is 0, which picks a free one; give a fixed port")
    host = EVERY_ADDRESS.get(config.ops_host, config.ops_host)
    return f"http{'s' if config.ops_tls else ''}://{join_address(host, config.ops_port)}/readyz"


def is_ready(url: str) -> bool:
    """Whether the URL answers 200. The certificate is not verified: it names the server as other machines know it."""
    https = urllib.request.HTTPSHandler(context=ssl._create_unverified_context())
    # Never through a proxy of the environment: the program is on this machine.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), https)
    try:
        with opener.open(url, timeout=TIMEOUT_S) as answer:
            return bool(answer.status == 200)
    except (OSError, ValueError, http.client.HTTPException):  # nobody listens, or the answer is not HTTP
        return False


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] | None = None) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="motiongen-server-ready",
        description="Tell by the exit code whether the server on this machine is ready.",
        epilog="It takes no other settings: it reads the environment variables of the program that it checks, such as "
        "MOTIONGEN_OPS_PORT. Exit code 0: ready; 1: not ready; 2: an invalid setting.",
    )
    parser.add_argument("--encoder", action="store_true", help="check the text encoder, with its own settings")
    options = parser.parse_args(arguments)
    parse = ENCODER.parse if options.encoder else SERVER.parse
    try:
        url = readiness_url(parse([], environment))
    except SettingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0 if is_ready(url) else 1


if __name__ == "__main__":
    sys.exit(main())
