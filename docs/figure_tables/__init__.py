"""The tables of the docs, one function each, from the results of docs/validation/*.json. SI units.

`docs/figures.py` calls them. A function takes the results of its files and returns Markdown; its name is the name of
its block in the pages.
"""

from figure_tables import (
    bases,
    cells,
    contact,
    cuts,
    elements,
    examples,
    exported,
    frequencies,
    haply,
    incompressible,
    laws,
    linear,
    membranes,
    organs,
    peers,
    readme,
    reduced_cuts,
    sampled,
    starts,
    steps,
)
from figure_tables.cells import BLOCKS, Block

__all__ = [
    "BLOCKS", "Block", "bases", "cells", "contact", "cuts", "elements", "examples", "exported", "frequencies", "haply",
    "incompressible",
    "laws", "linear", "membranes", "organs", "peers", "readme", "reduced_cuts", "sampled", "starts", "steps",
]  # fmt: skip
