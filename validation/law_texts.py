"""How long the longest texts that are allowed for a law take to compile (docs/reference/laws.md).

    python validation/law_texts.py [--texts 3] [--seed 0] [--kinds quotients functions powers towers stretches]

Random texts of each kind grow until another operation is refused. Each is differentiated and compiled as a reduced
model compiles it when it is loaded: the forces and the energy of its samples. Times are less those of a neo-Hookean
law that is compiled in the same way, which is what does not depend on the text, and in addition to it.
"""

from __future__ import annotations

import argparse
import tempfile
from contextlib import suppress
from dataclasses import replace
from time import perf_counter
from typing import Any

import numba
import numpy as np

import palpate as pt
from palpate.tissue.parameters import own_fields
from palpate.tissue.straight_line import FUNCTION_BY_NAME
from palpate.tissue.symbolic_law import law_of

REST = {"density": 1000.0, "poisson": 0.45}
KINDS = {  # variables, operators, the share of functions
    "quotients": (("I1bar", "I2bar", "J"), "+ - * /", 0.25),
    "functions": (("I1bar", "I2bar", "J"), "+ - * /", 0.6),
    "powers": (("I1", "I2bar", "J"), "* ** /", 0.2),
    "towers": (("I1", "I2", "J"), "**", 0.0),
    "stretches": (("l1", "l2", "l3"), "+ - * / **", 0.25),
}


def tree(rng: np.random.Generator, size: int, variables: tuple[str, ...], signs: str, share: float) -> str:
    """Return a random text of some operations."""
    if size <= 0:
        return str(rng.choice(variables if rng.random() < 0.6 else (*(f"c{i}" for i in range(8)), "1.7", "0.3")))
    if rng.random() < share:
        return f"{rng.choice(list(FUNCTION_BY_NAME))}({tree(rng, size - 1, variables, signs, share)})"
    left = int(rng.integers(size))
    one, two = (tree(rng, n, variables, signs, share) for n in (left, size - 1 - left))
    return f"({one} {rng.choice(signs.split())} {two})"


def largest(rng: np.random.Generator, kind: str) -> str:
    """Return the text of most operations, with its derivatives, of some hundred random ones that are allowed."""
    best, most = "", 0
    for size in range(4, 120, 2):
        for _ in range(8):
            text = tree(rng, size, *KINDS[kind])
            with suppress(pt.InputError):
                law: Any = law_of(text)
                steps = sum(len(f.__code__.co_varnames) for f in (law.energy, law.first, law.second))
                best, most = (text, steps) if steps > most else (best, most)
    return best


def unchecked(law: Any, split: str) -> Any:
    """Return a material of a law whose rest is not looked at."""
    material = object.__new__(law)
    own = dict.fromkeys(own_fields(law), 1.0)
    for name, value in {**REST, "bulk": 1e5, "prony": None, "volumetric": "mixed", "split": split, **own}.items():
        object.__setattr__(material, name, value)
    return material


def compiling(data: Any, text: str, split: str) -> tuple[float, float]:
    """Return the times [s] of making a law and of compiling a reduced model of it."""
    begun = perf_counter()
    law_of.__globals__["_law"].cache_clear()
    material = unchecked(law_of(text), split)
    made = perf_counter()
    model = pt.ReducedModel(replace(data, tissue=replace(data.tissue, material=material)))
    for compiled in (model.force, model.energy):
        with suppress(ZeroDivisionError):
            compiled(np.zeros(model.count))
    return made - begun, perf_counter() - made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--texts", type=int, default=3, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--split", default="coupled", choices=("coupled", "isochoric"))
    options = parser.parse_args()
    body = pt.Solid(pt.box((0.03, 0.01, 0.01), 0.0025), pt.materials.NeoHookean(C1=5e3, **REST), "x-", form="energy")
    run = pt.rollout(body, [pt.SurfaceForce("x+", force=(0.3, 0.05, -0.02))], duration=0.01, every=1e-3, progress=False)
    data = pt.hyper_reduce(body, run, modes=4).data
    with tempfile.TemporaryDirectory() as folder:
        numba.config.CACHE_DIR = folder  # nothing is found that another run has compiled
        compiling(data, "C1*(I1 - 3) - 2.5*C1*log(J)", options.split)  # with all that every law needs
        _, base = compiling(data, "C1*(I1 - 3) - 2*C1*log(J)", options.split)
        print(f"neo-Hookean, {options.split}: {base:.1f} s")
        for kind in options.kinds:
            for seed in range(options.seed, options.seed + options.texts):
                text = largest(np.random.default_rng(seed), kind)
                made, compiled = compiling(data, text, options.split)
                print(f"{kind} {seed}: {len(text)} characters, law {made:.2f} s, model {compiled - base:.1f} s more")


if __name__ == "__main__":
    main()
