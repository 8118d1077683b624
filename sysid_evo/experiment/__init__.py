"""Runs made of cells: fit these families, evolve against those ensembles, go on after an interruption."""

from sysid_evo.experiment.cells import Observer, Outcome, Silent, cell_seed, run_cell
from sysid_evo.experiment.evolving import ensemble_name, evolve_champions
from sysid_evo.experiment.fitting import fit_models, make_with_preset
from sysid_evo.experiment.presets import CONTROLLER_PRESETS, controller_preset

__all__ = [
    "CONTROLLER_PRESETS",
    "Observer",
    "Outcome",
    "Silent",
    "cell_seed",
    "controller_preset",
    "ensemble_name",
    "evolve_champions",
    "fit_models",
    "make_with_preset",
    "run_cell",
]
