"""Run as a command: ``python -m tipfem``."""

from tipfem.commands import main

if __name__ == "__main__":
    main()
