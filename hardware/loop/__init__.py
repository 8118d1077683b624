"""The control loop: from poses to states, from states to commands, at a fixed rate."""
