"""Run the command line: `python -m kinegraph`."""

import sys

from kinegraph.cli import main

if __name__ == "__main__":
    sys.exit(main())
