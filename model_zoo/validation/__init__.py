"""Blocks of time held out: what chooses hyper-parameters, and how far a prediction may be off."""
