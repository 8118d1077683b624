"""Python -m sysid_evo is sysid-evo."""

import sys


def main() -> None:
    """Run the command line. Ctrl-C ends it quietly, also while all of it is still being imported."""
    from sysid_evo.cli.console import INTERRUPTED

    try:
        from sysid_evo.cli.app import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
