"""A model meets another condition: corrections of its accelerations, and the gate that believes them or not."""

from sysid_evo.adaptation.adapting import ANEW, REFIT, Adaptation, Learned, adaptation
from sysid_evo.adaptation.another_condition import adapted, as_of
from sysid_evo.adaptation.gate import NONE, Trial, Verdict
from sysid_evo.adaptation.home import held_out_error
from sysid_evo.adaptation.terms import Terms

__all__ = [
    "ANEW",
    "NONE",
    "REFIT",
    "Adaptation",
    "Learned",
    "Terms",
    "Trial",
    "Verdict",
    "adaptation",
    "adapted",
    "as_of",
    "held_out_error",
]
