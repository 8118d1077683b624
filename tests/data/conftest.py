"""Until the last two modules of this folder have moved."""

from tests.unit.data.conftest import columns_file, make_drive, table, write_csv  # noqa: F401
