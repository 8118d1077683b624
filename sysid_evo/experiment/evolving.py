"""Evolving one controller against each of several ensembles, each a cell of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Champion, ControllerEvolution, evolve_controller
from sysid_evo.experiment.cells import Observer, Outcome, cell_seed, run_cell
from sysid_evo.progress import Progress
from sysid_evo.store import RunFolder, load_champion, save_champion
from sysid_evo.system import System


def ensemble_name(members: Sequence[str], aggregate: str = "min") -> str:
    """Return how an ensemble and its champion are called: ``a+b``, or ``mean(a+b)`` for another rule."""
    name = "+".join(members)
    return name if aggregate == "min" or len(members) == 1 else f"{aggregate}({name})"


def evolve_champions(
    run: RunFolder,
    ensembles: Sequence[Sequence[str]],
    runners: Mapping[str, Runner],
    system: System,
    settings: ControllerEvolution,
    *,
    seed: int,
    observer: Observer,
    reuse: bool = True,
) -> dict[str, Outcome[Champion]]:
    """Evolve one champion against each of ``ensembles`` (names of ``runners``) and store them in ``run``.

    With ``reuse`` a champion that the run already has is not evolved again.
    """
    return {
        ensemble_name(members, settings.aggregate): _evolve(
            run, members, runners, system, settings, seed=seed, observer=observer, reuse=reuse
        )
        for members in ensembles
    }


def _evolve(
    run: RunFolder,
    members: Sequence[str],
    runners: Mapping[str, Runner],
    system: System,
    settings: ControllerEvolution,
    *,
    seed: int,
    observer: Observer,
    reuse: bool,
) -> Outcome[Champion]:
    name = ensemble_name(members, settings.aggregate)
    path, cell = run.controller(name, seed), f"evolve {name}"

    def work(progress: Progress) -> Champion:
        missing = [member for member in members if member not in runners]
        if missing:
            raise InvalidArgument(f"no model {', '.join(missing)} to evolve against; there are {', '.join(runners)}")
        chosen = {member: runners[member] for member in members}
        return evolve_controller(name, chosen, system, settings, seed=cell_seed(seed, cell), progress=progress)

    return run_cell(
        run,
        cell,
        load=(lambda: load_champion(path)) if reuse else None,
        work=work,
        save=lambda champion: save_champion(champion, path),
        observer=observer,
    )
