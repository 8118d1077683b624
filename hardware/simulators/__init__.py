"""Environments of Gymnasium as robots: what they are made of, how they are recorded and how controllers run in them."""
