"""The command line, ``sysid-evo``: an application above the four packages."""
