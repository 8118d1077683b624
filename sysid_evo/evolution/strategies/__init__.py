"""The public names of the strategies."""
