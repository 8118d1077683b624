"""Differential equations whose right-hand side is a torch module: solved by torchdiffeq, trained on free runs."""
