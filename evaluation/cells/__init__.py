"""Comparisons: an experiment, the plan of its cells, and the report that is made of them."""
