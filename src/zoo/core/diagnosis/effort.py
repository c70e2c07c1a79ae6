"""How hard a screening searches: steps, rounds and turns; more of any finds the same modes, later."""

REFINED = 2
"""Locations of each effect whose search ends with fresh differences."""
FAR, FAR_STEPS, FAR_GAIN, FAR_ROUNDS = 0.1, 10, 1e-3, 4
"""Errors of a baseline's first descent, in parts of the range: far from the mode that is what a linearisation
is good for; its steps, the gain that ends it, and rounds of fresh differences after it."""
BASE_TURNS, BASE_STEPS = 3, 8
"""Turns in which the baseline and its noise are fitted, and steps beside a noise that is given."""
START_STEPS, AGAIN_STEPS, AGAIN_ROUNDS, AGAIN_TURNS = 12, 15, 6, 3
"""Steps of a descent from each start, in the first search and in the second; rounds of fresh differences in
the second, and turns in which fit and noise are found."""
POLISHED = 50
"""Solves of a simplex search for each parameter, where kinks make a linearisation promise too much."""
RETREAT = 0.3
"""Part of a start that is tried where the start cannot be solved; step of a shape, in units of the search."""
SHAPES = (0.0, -0.7, 1.5)
"""Shapes from which the second search starts: prior standard deviations away from the centre."""
ALIKE = 0.1
"""Part in the direction that the series tell least, above which a parameter is named as not told."""
SIZE_DRAWS = 50
"""Draws of the discrepancy from which the allowance is made."""
FREE_STEPS, FREE_ROUNDS = 4, 3
"""Steps of the baseline's parameters beside a free discrepancy, and turns in which these and the noise are
fitted."""
