"""Family auto: a choice among families by simulation of held-out data, and the mean of those that are kept."""
