"""Compiled forms of what the classic environments reward."""
