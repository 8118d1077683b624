"""What `auto` tries: families with their settings, in a fixed order, and about how long each takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from sysid_evo.errors import IncompatibleSystem, InvalidArgument, MissingExtra, PluginError
from sysid_evo.models import DynamicsModel
from sysid_evo.registry import Spec, models
from sysid_evo.system import System

STEPS = 7200.0
NUMBERS = 5.0
"""Steps of six minutes at 20 Hz, and states and controls of a car: what `Candidate.seconds` were measured with."""
ALONE = 0.25
"""Share of the time of four networks side by side that none of them needs by itself."""
OF_A_PLUGIN = 5.0
"""Seconds that a family counts that is not listed here."""


@dataclass(frozen=True)
class Candidate:
    """A family with its settings.

    ``seconds`` is how long one fit takes on one processor with `STEPS` steps of a car, of which the share ``growing``
    is in proportion to the number of steps, and the share ``widening`` to that of states and controls: a network of one
    state takes nearly as long as that of a car. In the fits that only judge it has the settings ``roughly``. One that
    ``refines`` another is the same with more training: it is tried only where the other stands well. Of a ``committee``
    what it learned without each fold stays beside what it learns from all data, unless it is far worse, and their mean
    is what is kept: fits to parts of the data differ in what these do not tell (Krogh and Vedelsby 1995).
    """

    spec: Spec
    seconds: float = OF_A_PLUGIN
    growing: float = 1.0
    roughly: dict[str, Any] = field(default_factory=dict)
    refines: Candidate | None = None
    committee: bool = False
    widening: float = 0.3

    @property
    def name(self) -> str:
        """What it is called: its label, if it has one of its own, or the whole spec."""
        return self.spec.text if self.spec.label == self.spec.name else self.spec.label

    def model(self, **changed: Any) -> DynamicsModel:
        """Return it unfitted. Raises what the registry says where it cannot be made."""
        found: DynamicsModel = models.make(self.spec.name, **{**self.spec.parameters, **changed})
        return found

    def seconds_for(self, system: System, steps: int, *, rough: bool) -> float:
        """Return about how many seconds of one processor a fit to so many steps takes."""
        size = 1.0 - self.widening + self.widening * (system.nx + system.nu) / NUMBERS
        most = self.spec.parameters.get("members", 1)
        members = self.roughly.get("members", most) if rough else most
        share = ALONE + (1.0 - ALONE) * members / most
        return self.seconds * share * size * (1.0 - self.growing + self.growing * steps / STEPS)

    def cost(self, system: System, steps: int, folds: int) -> float:
        """Return about how many seconds all its fits take: one for each fold, and one to all data."""
        learned = round(steps * (1.0 - 1.0 / max(2, folds)))
        return folds * self.seconds_for(system, learned, rough=True) + self.seconds_for(system, steps, rough=False)


def _one(text: str, seconds: float, growing: float = 0.1, **roughly: Any) -> Candidate:
    return Candidate(Spec.parse(text), seconds, growing, roughly)


def _networks(state_lags: int, control_lags: int, input_noise: float) -> Candidate:
    """Return four lagged networks; more input noise makes them better at long horizons and worse at short ones."""
    settings = {"state_lags": state_lags, "control_lags": control_lags, "input_noise": input_noise}
    training = {"members": 4, "one_step_updates": 1500, "updates": 600}
    label = Spec("mlp_ensemble", settings).text
    return Candidate(Spec("mlp_ensemble", {**settings, **training}, label), 9.5, 0.1, {"members": 2})


SHORT = Candidate(
    Spec.parse("nonlinear_state_space(members=3, mixtures=4, trial=6, iterations=15, horizon=300, most_steps=3000)"),
    seconds=10.0,
    growing=0.3,
    widening=1.0,
)
"""Hidden states with little training, which tells where more of it may be worth its time."""

PROCESS = _one("gaussian_process", 7.7, 0.5)
THREE = 3
PROCESSES = Candidate(
    Spec("average", {"families": [PROCESS.name] * THREE}, f"average of {THREE} {PROCESS.name}"),
    THREE * PROCESS.seconds,
    refines=PROCESS,
)
"""Which steps a sparse process is made of is drawn: where one does well, the mean of three that differ does better."""

SHIPPED: tuple[Candidate, ...] = (
    _one("narx(lag_search=few, terms=32, degree=none)", 0.6, 0.5),
    _networks(0, 5, 1.0),
    _networks(1, 3, 0.3),
    _networks(0, 5, 2.0),
    _one("linear_state_space(iterations=12, folds=1, most_steps=4000)", 0.9, 0.3),
    SHORT,
    PROCESS,
    _one("neural_ode_history(state_lags=0, control_lags=5, input_noise=1.0)", 7.0),
    _one("neural_ode(input_noise=0.5)", 6.0),
    _one("k_neighbours", 2.7, 1.0),
    _one("sindy(lag_search=few)", 1.2, 0.4),
    _networks(0, 5, 0.3),
    _one("neural_ode_history(state_lags=0, control_lags=3, input_noise=0.1)", 7.0),
    _one("sindy_discrete", 1.7, 0.4),
    _one("single_track(residual=true, starts=3, windows=120, residual_points=60)", 8.0, 0.3),
    _networks(0, 0, 3.0),
    _one("linear(state_lags=2, control_lags=2)", 0.1, 1.0),
    _one("hybrid_ode(state_lags=0, control_lags=5, input_noise=0.3)", 9.5),
    _one("parametrised", 3.7, 1.0),
    _networks(2, 5, 1.0),
    _one("neural_ode(input_noise=2.0)", 6.0),
    _one("neural_ode_history(state_lags=0, control_lags=5, input_noise=2.0)", 7.0),
    _one("hybrid_ode(state_lags=0, control_lags=5, input_noise=2.0)", 9.5),
    _networks(0, 2, 0.05),
    PROCESSES,
    Candidate(Spec("nonlinear_state_space"), 100.0, refines=SHORT, committee=True, widening=1.0),
)
"""What is tried unless candidates are named, the most telling for their time first."""


def offered(system: System) -> tuple[list[Candidate], list[str]]:
    """Return the candidates for ``system`` in their order, and why others are none.

    Registered families that declare a ``structure`` and are not among the shipped come first.
    """
    reasons = [(candidate, unusable(candidate, system)) for candidate in (*plugins(), *SHIPPED)]
    return [candidate for candidate, reason in reasons if not reason], [
        f"{candidate.name}: {reason}" for candidate, reason in reasons if reason
    ]


def named(texts: Sequence[str]) -> list[Candidate]:
    """Return the candidates ``texts`` name: a family alone stands for what is listed of it, else for its defaults.

    Raises what the registry says of wrong names, and `InvalidArgument` for `auto` itself.
    """
    found: list[Candidate] = []
    for spec in map(Spec.parse, texts):
        if spec.name == "auto":
            raise InvalidArgument("candidates: expected other families, got auto, which would try itself")
        models.check(spec)
        listed = [one for one in SHIPPED if one.spec.name == spec.name and one is not PROCESSES]
        found += [Candidate(spec)] if spec.parameters or not listed else [replace(one, refines=None) for one in listed]
    return found


def unusable(candidate: Candidate, system: System) -> str:
    """Return why a candidate cannot describe ``system`` or cannot run here; empty if it can."""
    try:
        lacking = models.lacking(candidate.spec.name)
        if lacking is not None:
            return str(lacking)
        model = candidate.model()
        model.check_system(system)
    except (IncompatibleSystem, MissingExtra, PluginError) as error:
        return str(error)
    if system.periods and not model.periodic:
        turning = ", ".join(channel.name for channel in system.states if channel.period)
        return f"it is not periodic, and {turning} comes round"
    return ""


def plugins() -> list[Candidate]:
    """Return the registered families that declare a structure and are no part of the zoo, by name."""
    found = []
    for name in models.names():
        if models.module(name).partition(".")[0] == __name__.partition(".")[0]:
            continue
        try:
            family: Any = models.get(name)
        except PluginError:  # listing the families tells of it
            continue
        if getattr(family, "structure", ""):
            found.append(Candidate(Spec(name), getattr(family, "usual_seconds", OF_A_PLUGIN)))
    return found
