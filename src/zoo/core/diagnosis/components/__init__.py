"""Which component of a simulator is wrong, and what the function should have been that it lacks."""
