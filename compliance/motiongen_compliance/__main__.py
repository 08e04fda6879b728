"""`motiongen-compliance HOST:PORT`: whether the server there keeps the protocol."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

SUITE = Path(__file__).with_name("suite")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="motiongen-compliance",
        description="Test that a server keeps the motiongen protocol. Takes a minute or two; opens some dozens of "
        "sessions, sends nonsense among them, and leaves nothing behind. Exit code 0: it does.",
        epilog="Further arguments go to pytest: --maxfail=1, -v, --junit-xml=report.xml.",
    )
    parser.add_argument("address", metavar="HOST:PORT", help="of the server")
    parser.add_argument("--ca", type=Path, metavar="FILE", help="certificates to trust, PEM: speak TLS, not plain text")
    parser.add_argument("-k", metavar="WORDS", help="only tests whose names have these words: 'resume and not lost'")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the suite. Returns the exit code: 0 all rules are kept, 1 some are not, 2 to 5 nothing was tested."""
    parser = _parser()
    asked, others = parser.parse_known_args(arguments)
    host, _, port = asked.address.rpartition(":")
    if not host or not port.isdigit():
        parser.error(f"{asked.address!r} is no address; give HOST:PORT, for example localhost:50051")
    if asked.ca is not None and not asked.ca.is_file():
        parser.error(f"there is no file {asked.ca}; give --ca a file of certificates, PEM")
    command = ["-c", str(SUITE.with_name("suite.ini")), "--rootdir", str(SUITE), "-p", "motiongen_compliance.plugin"]
    command += ["--server-address", asked.address]
    command += [] if asked.ca is None else ["--server-ca", str(asked.ca)]
    command += [] if asked.k is None else ["-k", asked.k]
    return int(pytest.main([*command, str(SUITE), *others]))


if __name__ == "__main__":
    sys.exit(main())
