"""`python -m motiongen_server.identity`: a new token, and the line of the tenants' file that lets it in."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from motiongen_server.identity.tokens import new_token


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m motiongen_server.identity",
        description="Make a token. It is printed once and kept nowhere: give it to who shall call, and its hash to the "
        "file of --tenants.",
    )
    parser.add_argument("tenant", help="whose it is, as the tenants' file is to name it")
    parser.add_argument("--days", type=int, default=0, help="for which it is good (default: until it is taken out)")
    options = parser.parse_args(arguments)
    if not options.tenant:
        parser.error("tenant is empty; give its name")
    if options.days < 0:
        parser.error(f"--days is {options.days}; it must be 0, for ever, or more")
    token, kept = new_token()
    until = ""
    if options.days:
        try:
            at = datetime.now(UTC).replace(microsecond=0) + timedelta(days=options.days)
        except OverflowError:
            parser.error(f"--days is {options.days}, which ends beyond the year 9999; leave it out for ever")
        until = f", expires = {at.isoformat().replace('+00:00', 'Z')}"
    print(token)
    print(f'[tenants.{_key(options.tenant)}]\ntokens = [{{ hash = "{kept}"{until} }}]', file=sys.stderr)
    return 0


def _key(name: str) -> str:
    """A key of TOML, in quotes."""
    return json.dumps(name, ensure_ascii=False).replace("\x7f", "\\u007f")  # in which JSON differs from TOML


if __name__ == "__main__":
    sys.exit(main())
