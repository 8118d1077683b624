"""Gaussian processes: their covariance and its likelihood."""
