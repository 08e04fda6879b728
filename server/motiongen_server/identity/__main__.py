"""`python -m motiongen_server.identity`: a new token, and the line of the tenants' file that lets it in."""

from __future__ import annotations

import argparse
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
    if options.days < 0:
        parser.error(f"--days is {options.days}; it must be 0, for ever, or more")
    token, kept = new_token()
    until = ""
    if options.days:
        at = datetime.now(UTC).replace(microsecond=0) + timedelta(days=options.days)
        until = f", expires = {at.isoformat().replace('+00:00', 'Z')}"
    print(token)
    print(f'[tenants."{options.tenant}"]\ntokens = [{{ hash = "{kept}"{until} }}]', file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
