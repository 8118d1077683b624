"""Optical trackers and other sources of a robot's pose, each behind one contract."""
