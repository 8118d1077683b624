"""Polynomials of few terms: their regression, their equations with units, their integration."""
