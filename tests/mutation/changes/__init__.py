"""The changes, by what they break."""

from tests.mutation.change import Change
from tests.mutation.changes import (
    comparing,
    controllers,
    data,
    evolution,
    exploits,
    families,
    plans,
    robots,
    statistics,
    worlds,
)

ALL: tuple[Change, ...] = (
    *statistics.CHANGES,
    *comparing.CHANGES,
    *exploits.CHANGES,
    *families.CHANGES,
    *evolution.CHANGES,
    *worlds.CHANGES,
    *plans.CHANGES,
    *data.CHANGES,
    *robots.CHANGES,
    *controllers.CHANGES,
)
