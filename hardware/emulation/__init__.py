"""Emulated robots: physics, the tracker beside them, and a connection in simulated time."""
