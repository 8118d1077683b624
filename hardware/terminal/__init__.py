"""The emulated car on a pseudo-terminal, in a process of its own: firmware, physics and tracker in real time."""
