"""Palpate and its peers."""

from __future__ import annotations

from figure_tables.cells import Row, block, markdown, signed


@block("peers", command="python benchmarks/peers.py", timed=True)
def peers(found: Row) -> str:
    """Return errors and computing times of palpate and its peers on the same lattices."""
    lines = []
    for case, program in dict.fromkeys((row["case"], row["program"]) for row in found["rows"]):
        rows = [row for row in found["rows"] if (row["case"], row["program"]) == (case, program)]
        moving = "step" in rows[0]
        times = "; ".join(f"{row['seconds_per_second' if moving else 'solve_seconds']:.3g}" for row in rows)
        nodes = "; ".join(f"{row['nodes']:,}" for row in rows)
        errors = "; ".join(signed(row["error"], unit="") for row in rows)
        lines.append([f"{case}: {program}", nodes, f"{times} {'s/s' if moving else 's'}", errors])
    return markdown(["case: program", "nodes", "computing time", "error [%]"], lines)
