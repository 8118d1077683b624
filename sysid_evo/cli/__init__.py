"""The command line, ``sysid-evo``."""

import sys

INTERRUPTED = 130
"""Exit code of a command that was stopped with Ctrl-C."""

__all__ = ["INTERRUPTED", "main"]


def main() -> None:
    """Run the command line. Ctrl-C ends it quietly, also while all of it is still being imported."""
    try:
        from sysid_evo.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
