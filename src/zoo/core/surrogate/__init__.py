"""A forward model's series as a graph of its parameters: a basis of solved series, and kriging."""
