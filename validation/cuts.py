"""Cuts of a body against closed forms: forces along a cut, its opening and energy release, and its stability.

    python validation/cuts.py [--parts patch halves penny strip trousers taut blade stability]
        [--bodies NAME ...] [--count 50]

writes docs/validation/cuts.json, which keeps the results of parts that were not asked for, and prints the figures.
`cut_cracks.py`, `cut_strip.py`, `cut_trousers.py`, `cut_taut.py` and `cut_stability.py` say what each part measures.
"""

from __future__ import annotations

import argparse
from typing import Any

import cut_cracks
import cut_stability
import cut_strip
import cut_taut
import cut_trousers
import numpy as np
import result_files

FINE = "generated liver, fine"
BOTH = ("box", "generated liver")  # bodies that meet every random cut at both Poisson's ratios
AXIS, OBLIQUE, JITTER = (0.0, 0.0, 1.0), cut_cracks.OBLIQUE, cut_cracks.JITTER


def patch() -> list[dict[str, Any]]:
    return [
        cut_cracks.patch(place, jitter) for jitter in (0.0, JITTER) for place in cut_cracks.PLANES
    ]  # fmt: skip


def halves() -> list[dict[str, Any]]:
    return [cut_cracks.halves(jitter) for jitter in (0.0, JITTER)]


def penny() -> list[dict[str, Any]]:
    rows = []
    for radius, half_width in ((5, 2.0), (10, 1.4)):
        for normal, jitter in ((AXIS, 0.0), (OBLIQUE, 0.0), (OBLIQUE, JITTER)):
            rows += cut_cracks.penny(radius, [0.3, 0.45, 0.49], normal, jitter, half_width)
    return rows


def strip() -> list[dict[str, Any]]:
    """Run strips; at a stretch of 1.8 the statics of an irregular cloud do not converge."""
    rows = []
    for law in cut_strip.LAWS:
        for stretch, jitter in ((0.25, 0.0), (0.25, JITTER), (0.5, JITTER), (0.8, 0.0)):
            moving = law == "neo-Hookean" and stretch < 0.5
            rows.append(cut_strip.strip(law, stretch, jitter, moving))
    return rows


def trousers() -> list[dict[str, Any]]:
    """Pull trousers apart on a lattice; on an irregular cloud the statics did not converge at 85 mm."""
    return cut_trousers.trousers(0.0, (75e-3, 85e-3, 95e-3))


def blade() -> list[dict[str, Any]]:
    kinds = cut_stability.KINDS
    seeds = [seed for seed in range(50) if kinds[seed % len(kinds)] in ("crossing", "adjacent")]
    return [cut_stability.advance("box", poisson, seed) for poisson in (0.45, 0.49) for seed in seeds[:4]]


def stability(name: str, count: int) -> list[dict[str, Any]]:
    """Cut a body at random; seeds alternate between Poisson's ratios where it does not meet every cut at both."""
    rows = []
    for seed in range(count):
        ratios = (0.45, 0.49) if name in BOTH else ((0.45, 0.49)[seed // len(cut_stability.KINDS) % 2],)
        rows += [cut_stability.run(name, poisson, seed) for poisson in ratios]
    return rows


def keep(part: str, found: list[dict[str, Any]]) -> None:
    """Write the results of a part; those of random cuts in place of the ones of the same body."""
    results = result_files.read("cuts", {})
    if part == "stability":
        found = [row for row in results.get(part, []) if row["body"] != found[0]["body"]] + found
    result_files.write("cuts", results | {part: plain(found)})


def main() -> None:
    """Run the parts asked for, and keep their results."""
    parts = {
        "patch": patch, "halves": halves, "penny": penny, "strip": strip, "trousers": trousers,
        "taut": cut_taut.in_runs, "blade": blade,
    }  # fmt: skip
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", choices=[*parts, "stability"], default=[*parts, "stability"])
    parser.add_argument("--bodies", nargs="+", choices=list(cut_stability.BODIES))
    parser.add_argument("--count", type=int, default=50, help="random cuts of a body")
    options = parser.parse_args()
    for name in options.parts:
        if name == "stability":
            for body in options.bodies or [each for each in cut_stability.BODIES if each != FINE]:
                keep(name, stability(body, options.count))
        else:
            keep(name, parts[name]())


def plain(value: Any) -> Any:
    """Return results with numbers of Python in place of those of NumPy."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value.item() if isinstance(value, np.generic) else value


if __name__ == "__main__":
    main()
