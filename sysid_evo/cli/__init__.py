"""The command line, ``sysid-evo``."""
