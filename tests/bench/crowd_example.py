"""What the crowd example costs: `python -m tests.bench.crowd_example`.

Runs `client/cpp/examples/crowd.cpp` unchanged: 500 characters on one stream of the null server, each drawn sixty times
a second, and sixty prompts a second for the whole crowd. The example measures itself while it draws. The C++ is built
as the tests build it (-O1).
"""

from __future__ import annotations

import argparse
import subprocess
import sys

from tests.bench.client_cost import UNBOUNDED
from tests.bench.machine import ROOT, busy_share, machine_facts
from tests.bench.null_process import NULL_SERVER, SETTINGS, server_process
from tests.cpp.building import build


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.crowd_example", description=__doc__)
    parser.add_argument("--characters", type=int, default=500, help="characters on one stream (default: %(default)s)")
    parser.add_argument("--seconds", type=int, default=10, help="duration of each trial (default: %(default)s)")
    parser.add_argument("--trials", type=int, default=3, help="how many, one after another (default: %(default)s)")
    options = parser.parse_args()
    folder = build("test", "-DMOTIONGEN_TESTS=ON", "-DMOTIONGEN_EXAMPLES=ON", targets=("crowd",))
    (program,) = (path for path in folder.rglob("crowd") if path.is_file())
    share = busy_share()
    for _ in range(options.trials):
        with server_process(NULL_SERVER, *SETTINGS, *UNBOUNDED) as server:
            command = [str(program), server.address, str(options.characters), str(options.seconds)]
            subprocess.run(command, cwd=ROOT, check=True)
    print("", *(f"- {name}: {value}" for name, value in machine_facts().items()), sep="\n")
    print(f"- others used: {share():.0%} of the machine meanwhile")
    return 0


if __name__ == "__main__":
    sys.exit(main())
