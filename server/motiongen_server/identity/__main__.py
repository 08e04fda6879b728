"""`python -m motiongen_server.identity`: prints a new token, and the entry for the tenants' file that admits it."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from motiongen_server.identity.tokens import new_token

MOST_DAYS = 36_500


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m motiongen_server.identity",
        description="Make a token. It is printed once and stored nowhere: give it to the caller, and add its hash to "
        "the file named by --tenants.",
    )
    parser.add_argument("tenant", help="the tenant's name in the tenants' file")
    parser.add_argument("--days", type=int, default=0, help="days until it expires (default: never)")
    options = parser.parse_args(arguments)
    if not 0 <= options.days <= MOST_DAYS:
        parser.error(f"--days is {options.days}; it must be 0, for no expiry, or at most {MOST_DAYS}")
    if not options.tenant or not options.tenant.isprintable():
        parser.error(f"tenant is {options.tenant!r}; it must be a name of printable characters")
    token, kept = new_token()
    until = ""
    if options.days:
        at = datetime.now(UTC).replace(microsecond=0) + timedelta(days=options.days)
        until = f", expires = {at.isoformat().replace('+00:00', 'Z')}"
    try:
        print(token, flush=True)
    except OSError as error:  # nobody will use a token that nobody has seen: do not print what would admit it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # else Python would try again when it ends
        print(f"error: the token could not be printed: {error.strerror}", file=sys.stderr)
        return 1
    name = json.dumps(options.tenant, ensure_ascii=False)  # the escapes of JSON are also valid in TOML
    print(f'[tenants.{name}]\ntokens = [{{ hash = "{kept}"{until} }}]', file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
