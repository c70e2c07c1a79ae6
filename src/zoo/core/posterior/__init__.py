"""Stored posteriors, what they predict, and how models compare."""
