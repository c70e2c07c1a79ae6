"""Paun et al. 2020 again: its tables, its figures, and whether the statistics are calibrated."""
