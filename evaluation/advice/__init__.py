"""Advice: sentences with numbers on what limits a recording or a model, and what to record next."""

from evaluation.advice.advise import MAX_REMARKS, advise_model, advise_recording, ranked
from evaluation.advice.evidence import Evidence, ModelAdvice, Recordings, Remark

__all__ = [
    "MAX_REMARKS",
    "Evidence",
    "ModelAdvice",
    "Recordings",
    "Remark",
    "advise_model",
    "advise_recording",
    "ranked",
]
