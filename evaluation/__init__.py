"""Compares models and controllers: prediction error, transfer, exploitability, report."""
