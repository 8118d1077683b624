"""Robots: their sessions and the loop that drives them, links, trackers, recording, emulated and simulated robots.

The process of a tracker starts from inside this package, so nothing is imported here.
"""
