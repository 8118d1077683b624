"""Advice: sentences with numbers on what limits a recording or a model, and what to record next."""

from evaluation.advice.advise import advise_model

__all__ = ["advise_model"]
