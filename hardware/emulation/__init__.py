"""Emulated robots: physics, sensors or an optical tracker, and sessions in simulated time."""
