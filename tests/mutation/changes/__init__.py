"""The changes, by what they break."""

from tests.mutation.change import Change
from tests.mutation.changes import (
    adaptation,
    clusters,
    comparing,
    conditions,
    controllers,
    data,
    evolution,
    exploits,
    families,
    figures,
    intervals,
    plans,
    robots,
    statistics,
    studies,
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
    *figures.CHANGES,
    *studies.CHANGES,
    *clusters.CHANGES,
    *adaptation.CHANGES,
    *conditions.CHANGES,
    *intervals.CHANGES,
)
