"""Models in a condition that they were not fitted to: before and after adaptation."""
