"""Kernels of single families; those that several share are in the kernel library of the engine."""
