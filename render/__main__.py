"""Run as a command: ``python -m tipfem.render``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
