"""Simulators of others as robots, one module each: how they are recorded and how controllers run in them."""
