"""`python -m tests.bench`: what `make bench` runs."""

import sys

from tests.bench.service_figures import main

if __name__ == "__main__":
    sys.exit(main())
