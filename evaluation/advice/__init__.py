"""Advice after a fit: what limits a model, in sentences with numbers, and what to record next."""

from evaluation.advice.advise import MOST, advise_model
from evaluation.advice.evidence import Evidence, ModelAdvice, Remark

__all__ = [
    "MOST",
    "Evidence",
    "ModelAdvice",
    "Remark",
    "advise_model",
]
