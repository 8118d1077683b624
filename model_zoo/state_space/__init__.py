"""State spaces with unmeasured states: initial states, training, observers and steps."""
