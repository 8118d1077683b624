"""What fits cost and how well the models then predict, of this checkout and of another."""
