"""A card for each model: error, trust, equations, parameters, poles; linearised responses of all models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.formatting import by_error, few, three_digits
from evaluation.linearisation import FASTEST, LinearResponse, OperatingPoint, least_squares
from evaluation.plots import plot_responses
from evaluation.report.document import Interval, Number, Options, Part
from evaluation.report.elements import FigureElement, Fold, Item, Section, TableElement, wide_and_narrow
from evaluation.report.sections.exploitability import trust_of
from evaluation.results import ComparisonResults, ModelSummary

if TYPE_CHECKING:
    from matplotlib.figure import Figure


USELESS = "worse than both no change and a linear model"


def section(report: ComparisonResults) -> Section | None:
    """Return a folded card for each model, then step and frequency responses of all; None without models."""
    if not report.models:
        return None
    cards = [Fold(_line(model, report), list(_parts(model, report.data.point))) for model in report.models]
    rough = [f"{model.name} ({model.not_linearised})" for model in report.models if model.not_linearised]
    absent = [f"Not linearised, so without poles and responses: {few(rough)}."] if rough else []
    return Section("Models", [*cards, *response_pictures(report)], absent=absent, background=True)


def _line(model: ModelSummary, report: ComparisonResults) -> str:
    """Return name, error, trust and knowledge of a model in one line."""
    prediction, parts = report.prediction, []
    if prediction is not None and model.name in prediction.names:
        found = prediction.model(model.name)
        score = found.score(prediction.cases.main_horizon)
        parts += [] if score is None else [f"N {three_digits(score.n)}"]
        parts += [USELESS] if found.warning else []
    for claims in report.exploitability:
        if claims.model == model.name:
            trusted, reasons = trust_of(claims, report)
            parts.append(
                {True: "trusted", False: f"not trusted ({'; '.join(reasons)})", None: "trust not known"}[trusted]
            )
    return f"{model.name}: {', '.join([*parts, f'{model.knowledge} box'])}"


def _parts(model: ModelSummary, point: OperatingPoint | None) -> Iterator[Item]:
    if model.equations:
        sides = tuple(tuple(line.split(" = ", 1)) for line in model.equations)
        yield TableElement(f"Equations of {model.name}", ("of", "equation"), sides, prose=True)
    if model.parameters_table:
        rows = tuple(_parameter(row) for row in model.parameters_table)
        heads = ("parameter", "value ± standard error", "unit", "bounds", "determined\nby the data")
        yield TableElement(f"Parameters of {model.name}", heads, rows, note=_correlated(model))
    if model.linear is not None and point is not None:
        yield pole_table(model.name, model.linear, point)
    if model.candidates:
        keys = tuple(dict.fromkeys(key for row in model.candidates for key in row))
        rows = tuple(tuple(row.get(key, "–") for key in keys) for row in model.candidates)
        yield TableElement(f"Candidates of {model.name}", keys, rows, prose=True)
    settings = [("family", model.family), *((name, str(value)) for name, value in model.parameters.items())]
    yield TableElement(f"Hyper-parameters of {model.name}", ("name", "value"), tuple(settings), prose=True)


def _correlated(model: ModelSummary) -> str:
    """Return the pairs of strongly correlated parameters, and what that means; empty without any."""
    found = {
        tuple(sorted((str(row["parameter"]), other))): value
        for row in model.parameters_table
        for other, value in row.get("correlations", {}).items()
    }
    if not found:
        return ""
    strongest = sorted(found, key=lambda pair: -abs(found[pair]))
    pairs = few([f"{one} and {other} ({found[one, other]:+z.3f})" for one, other in strongest])
    return (
        f"Correlated: {pairs}. The data determine such a pair together better than each of the two: an error of one "
        "is compensated by the other."
    )


SHOWN_POLES = 8
"""Poles in a table, the slowest first."""


def pole_table(name: str, linear: LinearResponse, point: OperatingPoint) -> TableElement:
    """Return the poles of a linearised model: discrete, continuous, with frequency, damping and time constant."""
    rows, system = [], point.steps.system
    for z in linear.poles[:SHOWN_POLES]:
        s, sign = linear.continuous(z), "±" if z.imag else "+"  # a negative real pole has no partner
        pole = (three_digits(one.real) + (f" {sign} {three_digits(one.imag)}j" if one.imag else "") for one in (z, s))
        damping = -s.real / abs(s) if abs(s) > INTEGRATES else None
        lasting = three_digits(-1.0 / s.real) if s.real < -INTEGRATES else "grows" if s.real > INTEGRATES else "–"
        rows.append((*pole, three_digits(abs(s)), three_digits(damping), lasting))
    faster = len(linear.poles) - len(rows)
    channels = zip((*system.states, *system.controls), (*point.state, *point.control), strict=True)
    at = ", ".join(f"{channel.name} {three_digits(value)} {channel.unit}".rstrip() for channel, value in channels)
    return TableElement(
        f"Poles of {name}",
        ("pole z", "s = ln(z) / dt\n(rad/s)", "frequency |s|\n(rad/s)", "damping\nratio", "time\nconstant (s)"),
        tuple(rows),
        note=f"Linearised at the mean of the training data in motion ({at}), dt = {linear.dt:g} s. "
        + (f"{faster} faster {'pole is' if faster == 1 else 'poles are'} left out. " if faster else "")
        + f"Poles with |z| < {FASTEST:g} are delays and memory, and not listed.",
    )


INTEGRATES = 1e-6
"""Size of a pole in rad/s up to which it is an integrator, without damping and time constant."""

STEPS = (20, 200)
"""Fewest and most samples of a step response."""
LASTING = 3.0
"""Length of a step response, in time constants of the slowest pole of the linear fit."""
POINTS, OUTPUTS, CONTROLS = 60, 4, 3
"""Most points of a line; most states and controls in a figure."""


def response_pictures(report: ComparisonResults) -> list[FigureElement]:
    """Return step and frequency responses of all linearised models and of the linear fit; empty without models."""
    point, system = report.data.point, report.data.system
    found = {model.name: model.linear for model in report.models if model.linear is not None}
    reference = None if point is None or not found else least_squares(point)
    if reference is None or point is None:
        return []
    all_of = {"linear fit": reference, **found}
    slowest = max((-1.0 / reference.continuous(z).real for z in reference.poles if abs(z) < 1.0), default=0.0)
    count = int(np.clip(LASTING * slowest / reference.dt, *STEPS))
    samples = np.unique(np.round(count * np.linspace(0.0, 1.0, POINTS) ** 1.5)).astype(int)  # more at the start
    times = np.asarray(samples * reference.dt, dtype=np.float64)
    w = np.geomspace(2.0 * np.pi / (count * reference.dt), np.pi / reference.dt, POINTS)
    effect = np.abs(reference.to_step(count)).max(axis=0) * point.spread[system.nx :] / point.spread[: system.nx, None]
    rows, columns = (  # those with the largest effect
        sorted(np.argsort(-effect.max(axis=axis), kind="stable")[:most].tolist())
        for axis, most in ((1, OUTPUTS), (0, CONTROLS))
    )
    states, controls = [system.states[i] for i in rows], [system.controls[i] for i in columns]
    after = {name: one.to_step(count)[np.ix_(samples, rows, columns)] for name, one in all_of.items()}
    gains = {name: np.abs(one.to_frequency(w))[:, rows][:, :, columns] for name, one in all_of.items()}

    def draw_steps(figure: Figure) -> None:
        plot_responses(figure, times, after, states, controls, label="time (s)")

    def draw_gains(figure: Figure) -> None:
        plot_responses(figure, w, gains, states, controls, label="frequency (rad/s)", log=True)

    shown = "" if effect.size == len(rows) * len(columns) else " The states and controls with the largest effect."
    height = 0.7 + 1.2 * len(rows)
    return [
        FigureElement(
            f"{what} of each state to each control",
            f"{sentences} Models linearised at the mean of the training data in motion; linear fit: least squares "
            f"over all of these data.{shown}",
            (wide_and_narrow(key, f"{what.lower()} of each state to each control", draw, height, height),),
            details=True,
        )
        for what, key, draw, sentences in (
            ("Step responses", "step-responses", draw_steps, "Change after a unit step at 0 s."),
            ("Frequency responses", "frequency-responses", draw_gains, "Gain, up to half the sampling frequency."),
        )
    ]


def _parameter(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a row of a parameter table as text."""
    value, error = row.get("value"), row.get("standard error")
    text = f"{value:.4g}"
    if error is not None and np.isfinite(error) and error > 0.0:
        text = f"{by_error(value, error)} ± {by_error(error, error)}"
    bounds = [f"{end:g}" if end is not None and np.isfinite(end) else "–" for end in (row.get("low"), row.get("high"))]
    determined = {True: "yes", False: "no", None: "–"}[row.get("determined")]
    return str(row["parameter"]), text, str(row.get("unit") or "–"), " to ".join(bounds), determined


class PolesPart(Part):
    """Poles of a model linearised at the mean of the training data, discrete, as real and imaginary part."""

    dt: Number
    poles: tuple[Interval, ...]


class ModelPart(Part):
    """A model: its hyper-parameters, and what it learned, empty for a family without it.

    ``not_linearised`` is the reason why there are no poles.
    """

    name: str
    family: str
    knowledge: str
    parameters: Options
    equations: tuple[str, ...]
    parameters_table: tuple[Options, ...]
    candidates: tuple[dict[str, str], ...]
    linear: PolesPart | None
    not_linearised: str

    @classmethod
    def of(cls, model: ModelSummary) -> ModelPart:
        """Return a model with its poles alone of what was linearised."""
        linear = model.linear
        poles = () if linear is None else tuple((z.real, z.imag) for z in linear.poles)
        return cls.made_of(model, linear=None if linear is None else PolesPart(dt=linear.dt, poles=poles))
