"""Differential equations with a network in them: stepped in NumPy, trained on free runs."""
