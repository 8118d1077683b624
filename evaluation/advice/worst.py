"""The region of states and controls where a model is worst."""

from __future__ import annotations

import numpy as np

from evaluation.advice.evidence import Evidence
from evaluation.advice.remark import Remark
from evaluation.labels import percent
from evaluation.prediction import PredictionProtocol, measured_cases, worst_region
from evaluation.prediction.regions import region_errors

RESAMPLES = 300


def weak_region(evidence: Evidence) -> Remark | None:
    """Return the region where the error is clearly larger than elsewhere, see `region_errors`."""
    lags = evidence.model.n_lags
    protocol = PredictionProtocol(first=max(PredictionProtocol.first, lags), resamples=RESAMPLES)
    cases = measured_cases(evidence.training, evidence.judged, protocol)
    steps = cases.near_horizon
    if steps is None:
        return None
    predicted = evidence.model.simulate(*cases.history(lags), cases.windows.controls[:, :steps])
    if not np.isfinite(predicted).all():
        return None
    worst = worst_region(region_errors(cases, predicted, steps))
    if worst is None:
        return None
    return Remark(
        "weak region",
        f"{evidence.name} is worst with {worst.region.words}, {percent(worst.share)} of the windows: N {worst.n:.3f} "
        f"after {steps * evidence.system.dt:g} s, {worst.ratio:.1f} times that of all. Record more there, and see what "
        "is different.",
        worst.share * (1.0 - 1.0 / worst.ratio),
        {"ratio": worst.ratio, "share": worst.share},
    )
