"""The command line, ``sysid-evo``."""

from sysid_evo.cli.app import main

__all__ = ["main"]
