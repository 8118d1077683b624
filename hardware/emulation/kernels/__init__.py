"""Kernels of the emulated robots."""
