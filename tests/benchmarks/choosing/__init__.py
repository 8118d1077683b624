"""Whether `auto` chooses as well as one could by hand."""
