"""Blind trials of the diagnosis: drawn units at carrier level, sealed labels, gates with their intervals, baselines on the same data."""
