"""Model families, one file each; they reach the rest through the registry of models."""
