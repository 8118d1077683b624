"""Evolution strategies, which propose candidates and learn from their fitness."""
