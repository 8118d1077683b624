"""Networks as plain arrays, and their training on free runs."""
