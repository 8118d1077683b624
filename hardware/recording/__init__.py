"""Manoeuvres that excite a robot, and what writes down how it answers."""
