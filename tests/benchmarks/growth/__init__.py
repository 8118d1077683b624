"""How cost and memory grow with the size of what is asked for."""
