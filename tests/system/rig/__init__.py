"""The test rig: the emulated car on a pseudo-terminal, its firmware, physics and tracker in a process of their own."""
