"""The command line: one file per subcommand, which parses, calls and prints."""

from trocar.cli.program import main

__all__ = ["main"]
