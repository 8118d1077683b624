"""Tools of the field side by side: error, time, and the controllers evolved in their models."""
