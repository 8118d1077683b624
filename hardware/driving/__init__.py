"""Driving by hand: a local web page, the keys pressed on it, and the trials driven with them."""
