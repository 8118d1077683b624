"""Adaptation of models to new conditions: corrections of accelerations, and the acceptance test."""

from sysid_evo.models.adaptation.selection import held_out_error

__all__ = ["held_out_error"]
