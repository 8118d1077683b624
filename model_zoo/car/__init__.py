"""The physics of a car on a plane: which channels play its roles, and its equation."""
