"""``python -m sysid_evo`` is ``sysid-evo``."""

import signal
import sys


def main() -> None:
    """Run the command line. Ctrl-C ends it quietly, also while it is still being imported."""
    try:
        from sysid_evo.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)


if __name__ == "__main__":
    main()
