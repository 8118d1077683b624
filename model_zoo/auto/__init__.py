"""Family auto: the mean of the families that simulate held-out data best."""
