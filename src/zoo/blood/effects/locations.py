"""Where an effect can act: functions from anything with a `network`, such as a forward model."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from zoo.blood.network import Network
from zoo.core.effects import Location


class Tree(Protocol):
    """Anything with a network."""

    @property
    def network(self) -> Network:
        """The study's tree of vessels."""


def at_vessel(vessel: int, subtree: bool = False) -> Location:
    """One vessel, by its id, or that one and all below."""
    return Location(int(vessel), subtree, "vessel")


def has_junctions(model: Tree) -> bool:
    """Whether some vessel feeds another."""
    return bool(np.any(model.network.parent >= 0))


def windkessels_only(model: Tree) -> bool:
    """Whether no outlet is a single resistance, or given by its impedance."""
    network = model.network
    return network.response_cosine is None and bool(np.all(network.R2[network.terminals] > 0))


def each_vessel(model: Tree) -> tuple[Location, ...]:
    """Every vessel."""
    return tuple(at_vessel(vessel) for vessel in model.network.ids)


def vessels_and_subtrees(model: Tree) -> tuple[Location, ...]:
    """Every vessel, and everything below and with each vessel that is neither the root nor a terminal."""
    network = model.network
    inner = [i for i in range(1, len(network.ids)) if len(network.children(i))]
    return each_vessel(model) + tuple(at_vessel(network.ids[i], True) for i in inner)


def sides_and_terminals(model: Tree) -> tuple[Location, ...]:
    """The sides of the first branching, one of two or all of more, and every terminal."""
    network, at = model.network, 0
    while len(network.children(at)) == 1:
        at = int(network.children(at)[0])
    sides = network.ids[network.children(at)]
    sides = sides[: 1 if len(sides) == 2 else len(sides)]
    terminals = network.ids[network.terminals]
    return tuple(at_vessel(v, True) for v in sides) + tuple(at_vessel(v) for v in terminals)
