"""`motiongen-compliance HOST:PORT`: test whether the server there keeps the protocol."""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from motiongen_compliance.output import command
from motiongen_compliance.reach import Unreachable, credentials_of, reach, token_of

SUITE = Path(__file__).with_name("suite")
NOTHING_TESTED = 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="motiongen-compliance",
        description="Test that a server keeps the motiongen protocol. Takes a minute or two; opens some dozens of "
        "sessions, sends invalid messages, and leaves nothing behind. Exit code 0: it does; 1: it does not; 2 to 5: "
        "nothing was tested.",
        epilog="Further arguments go to pytest: --maxfail=1, -v, --junit-xml=report.xml.",
    )
    parser.add_argument("address", metavar="HOST:PORT", help="address of the server")
    parser.add_argument("--ca", type=Path, metavar="FILE", help="certificates to trust, PEM; turns TLS on")
    parser.add_argument("--certificate", type=Path, metavar="FILE", help="the client's certificate, PEM, with --ca")
    parser.add_argument("--key", type=Path, metavar="FILE", help="PEM file of its key")
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="file with the caller's token")
    parser.add_argument("-k", metavar="WORDS", help="only tests whose names have these words: 'resume and not lost'")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the suite. Returns the exit code: 0 all rules are kept, 1 some are broken, 2 to 5 nothing was tested."""
    return command(lambda: _test(arguments)) or 0


def _test(arguments: Sequence[str] | None) -> int:
    parser = _parser()
    asked, others = parser.parse_known_args(arguments)
    host, _, port = asked.address.rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 1 << 16):
        parser.error(f"{asked.address!r} is not an address; give HOST:PORT, for example localhost:50051")
    files = {name: getattr(asked, name) for name in ("ca", "certificate", "key", "token_file")}
    for name, path in files.items():
        if path is not None and not path.is_file():
            parser.error(f"there is no file {path}; give --{name.replace('_', '-')} one that can be read")
    if (asked.certificate is None) != (asked.key is None) or (asked.key is not None and asked.ca is None):
        parser.error("--certificate and --key must be given together, and with --ca")
    try:
        credentials = credentials_of(asked.ca, asked.key, asked.certificate)
        asyncio.run(reach(asked.address, credentials, token_of(asked.token_file)))
    except (OSError, ValueError) as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        print(f"{parser.prog}: interrupted; nothing was tested", file=sys.stderr)
        return NOTHING_TESTED
    except Unreachable as error:
        print(f"{parser.prog}: nothing was tested: {error}", file=sys.stderr)
        return NOTHING_TESTED
    command = ["-c", str(SUITE.with_name("suite.ini")), "--rootdir", str(SUITE), "-p", "motiongen_compliance.plugin"]
    command += ["--server-address", asked.address]
    for name, path in files.items():
        command += [] if path is None else [f"--server-{name.replace('_', '-')}", str(path)]
    command += [] if asked.k is None else ["-k", asked.k]
    return int(pytest.main([*command, str(SUITE), *others]))


if __name__ == "__main__":
    sys.exit(main())
