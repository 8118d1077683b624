"""Public names of validation."""
