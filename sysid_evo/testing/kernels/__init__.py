"""Compiled functions of the kits: read by Numba, which infers their types."""
