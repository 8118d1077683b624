"""Studies: a grid of comparisons as one plan, and its results over robots and seeds."""
