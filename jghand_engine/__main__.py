"""`python -m jghand_engine` is the command `jghand`."""

import sys

from jghand_engine.cli import main

if __name__ == "__main__":
    sys.exit(main())
