"""The robot: emulated cars, trackers, excitation, recording."""
