"""Adaptation of models to new conditions: corrections of accelerations, and the acceptance test."""

from sysid_evo.models.adaptation.action import ActionCorrection
from sysid_evo.models.adaptation.adapted import as_of
from sysid_evo.models.adaptation.correction import CorrectionTerms
from sysid_evo.models.adaptation.selection import (
    NEW_FIT,
    NONE,
    REFIT,
    Adaptation,
    AdaptationDecision,
    LearnedCorrection,
    adaptation,
    held_out_error,
)
from sysid_evo.validation.acceptance import AcceptanceResult

__all__ = [
    "NEW_FIT",
    "NONE",
    "REFIT",
    "AcceptanceResult",
    "ActionCorrection",
    "Adaptation",
    "AdaptationDecision",
    "CorrectionTerms",
    "LearnedCorrection",
    "adaptation",
    "as_of",
    "held_out_error",
]
