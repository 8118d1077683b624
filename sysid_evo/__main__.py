"""``python -m sysid_evo`` is ``sysid-evo``."""

from sysid_evo.cli import main

if __name__ == "__main__":
    main()
