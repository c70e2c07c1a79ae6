"""What a baseline model of blood flow may lack: a catalogue of effects, zero in the baseline.

An effect takes a `zoo.blood.case.Case`, a solve about to be made, and returns a changed copy: another
network, another inflow, other parameters, terms inside the solver (`zoo.blood.solver.Physics`), or a function
that acts on the solved waves, as a sensor does. To add one, write a function with `@effect(...)`, here or in
a file of your own; docs/effects.md shows one of ten lines.
"""

from zoo.blood.blood_flow import FAMILIES
from zoo.blood.case import Case, Wave
from zoo.blood.effects.catalogue import CATALOGUE, effect
from zoo.blood.effects.given import added_effects
from zoo.blood.effects.locations import at_vessel, each_vessel, sides_and_terminals, vessels_and_subtrees
from zoo.core.effects import Effect, EffectError, EffectParameter, Location, everywhere

# in the order in which those of a family are applied
from zoo.blood.effects import geometry, wall, fluid, junctions, outflow, structured_tree  # isort: skip
from zoo.blood.effects import surroundings, inflow, sensor, noise, numerics  # isort: skip
