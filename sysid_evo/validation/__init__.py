"""Validation: held-out data, simulation errors, prediction intervals, comparison of models.

It depends on data and arrays only; models are used through the protocol `Simulator`. The error of a simulation is
`sysid_evo.validation.simulation_error.simulation_error`.
"""
