"""A comparison made again of its run folder: by reports, and by processes that compute cells for another one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evaluation.comparison.data_cells import GivenData
from evaluation.comparison.experiment import Experiment
from evaluation.comparison.planning import Comparison, plan_comparison
from evaluation.transfer import load_measured
from sysid_evo.errors import ArtefactError
from sysid_evo.plan import Plan, Store, StoredCell
from sysid_evo.registry import load_plugin


def comparison_again(experiment: Experiment, run: Path) -> tuple[Comparison, tuple[str, ...]]:
    """Return the comparison whose data stand in the folder ``run``, and remarks on what is damaged there.

    Raises `ArtefactError` if the data are missing or damaged.
    """
    for plugin in experiment.plugins:
        load_plugin(plugin)
    store = Store(run)
    record = store.find(experiment.data_digest or "")
    data = None if record is None else StoredCell(record, GivenData)
    if data is None or not store.done(data):
        raise ArtefactError(f"{run}: the data of this run are missing or damaged; repeat its command to prepare them")
    measured, damaged = load_measured(run)
    system = store.load(data).training.system
    return plan_comparison(experiment, stored=(data, system), measured=measured), tuple(damaged)


def plan_again(settings: Mapping[str, Any], run: Path) -> Plan:
    """Return the plan of the comparison with these settings."""
    return comparison_again(Experiment.of(settings), run)[0].plan
