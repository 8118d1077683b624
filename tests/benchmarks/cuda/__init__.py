"""How fast rollouts are on a CUDA device, and how much of it they use."""
