"""Passivity and times of the adapter of Haply devices."""

from __future__ import annotations

from figure_tables.cells import Row, block, markdown

DELAYS = (0.005,)  # [s] of the readings that the table has


@block("haply", command="python validation/haply.py --parts passivity")
def haply_passivity(results: Row) -> str:
    """Return the damping that a wall needs, and the energy that a free hand received, by stiffness and delay."""
    heads = ["stiffness", "delay", "damping needed, measured", "with the local model", "energy out: reading alone"]
    lines = [
        [
            f"{1e-3 * row['stiffness']:g} kN/m", f"{1e3 * row['delay']:g} ms",
            f"{row['limit']:.3g}, {row['measured']:.3g} N s/m",
            f"{row['local_limit']:.3g}, {row['local_measured']:.3g} N s/m",
            *(f"{1e3 * row[name]['most']:.2g} mJ" for name in ("reading", "local", "whole")),
        ]
        for row in results["passivity"]
        if row["delay"] in DELAYS
    ]  # fmt: skip
    return markdown([*heads, "with the local model", "and the observer"], lines)


@block("haply", command="python validation/haply.py --parts times", timed=True)
def haply_times(results: Row) -> str:
    """Return the times until a hand is free, by failure."""
    failures = results["times"]["failures"]
    lines = [
        [failure, f"{1e3 * each['median']:.1f} ms", f"{1e3 * each['largest']:.1f} ms", str(each["count"])]
        for failure, each in failures.items()
    ]
    return markdown(["failure", "hand free after, median", "largest", "trials"], lines)
