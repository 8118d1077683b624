"""The robot: its link, the trackers that see it, the loop that drives it, recording, and emulated robots."""
