"""`motiongen-server-ready`: whether the server, or with `--encoder` the text encoder, of this environment is ready.

For the health checks of containers and supervisors, with the settings that the program beside it has got by its
environment: exit code 0 where it is ready, 1 where it is not, 2 for a wrong setting.
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
"""What means all addresses of a machine -> the one that it has itself."""


class OpsSettings(Protocol):
    """Settings of either program, by their names."""

    @property
    def ops_host(self) -> str: ...

    @property
    def ops_port(self) -> int: ...

    @property
    def ops_tls(self) -> bool: ...


def readiness_url(config: OpsSettings) -> str:
    """Where a program says whether it is ready, as seen from its own machine. Raises SettingError for any free port."""
    if config.ops_port == 0:
        raise SettingError("ops_port is 0, which picks a free one; give a port that can be asked for")
    host = EVERY_ADDRESS.get(config.ops_host, config.ops_host)
    return f"http{'s' if config.ops_tls else ''}://{join_address(host, config.ops_port)}/readyz"


def is_ready(url: str) -> bool:
    """Whether it says so. Its certificate is not checked: it names the server as others know it."""
    https = urllib.request.HTTPSHandler(context=ssl._create_unverified_context())
    # Not by a proxy that the environment names for what is far away.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), https)
    try:
        with opener.open(url, timeout=TIMEOUT_S) as answer:
            return bool(answer.status == 200)
    except (OSError, ValueError, http.client.HTTPException):  # nobody listens, or who does speaks something else
        return False


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] | None = None) -> int:
    """The exit code."""
    parser = argparse.ArgumentParser(prog="motiongen-server-ready", description="Whether the server here is ready.")
    parser.add_argument("--encoder", action="store_true", help="ask the text encoder, by its own settings")
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
