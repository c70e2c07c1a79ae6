"""Where a baseline model misses the data, and which effect explains it."""
