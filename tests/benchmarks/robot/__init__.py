"""Measurements of the control loop on emulated robots."""
