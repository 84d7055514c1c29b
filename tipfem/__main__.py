"""Run as a command: ``python -m tipfem``."""

from tipfem.app.main import main

if __name__ == "__main__":
    main()
