"""One-dimensional blood flow: studies, the solver, its forward model, its effects."""
