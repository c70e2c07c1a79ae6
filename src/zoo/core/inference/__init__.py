"""Modes, step methods, chains in processes, and when they have converged."""
