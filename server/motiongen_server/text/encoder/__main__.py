"""`python -m motiongen_server.text.encoder`: reads the configuration and serves the encoder."""

from __future__ import annotations

import os
import signal
import sys


def end_at_once(_number: int, _frame: object) -> None:
    """End the process: nothing has been started yet that would have to be stopped."""
    os._exit(0)


def main() -> int:
    """Returns 0 after an orderly end, 2 for an invalid setting."""
    # The first process of a container is not ended by signals that it does not handle.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end_at_once)
    # gRPC reads this when it is imported. Without it, every header that gRPC cannot read and every failed handshake is
    # logged.
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")
    import asyncio

    from motiongen_server.ops.logs import configure_logs
    from motiongen_server.settings import SettingError
    from motiongen_server.text.encoder.app import run
    from motiongen_server.text.encoder.config import ENCODER

    try:
        config = ENCODER.parse(sys.argv[1:])
    except SettingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    configure_logs(config.log_level, config.log_format)
    return asyncio.run(run(config))


if __name__ == "__main__":
    sys.exit(main())
