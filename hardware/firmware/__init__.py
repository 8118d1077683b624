"""The robot's side of the link: the protocol core in C, how it is built and called on the host."""
