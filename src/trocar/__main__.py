"""`python -m trocar` is the command line."""

from trocar.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
