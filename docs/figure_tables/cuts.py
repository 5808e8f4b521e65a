"""Cuts: forces along them, their opening and energy release, and their stability."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from statistics import median

from figure_tables.cells import Row, block, largest, markdown, signed, span

CRACKS = "python validation/cuts.py --parts patch halves penny strip blade"
STRIPS = "python validation/cuts.py --parts strip blade"
TROUSERS = "python validation/cuts.py --parts trousers"
TAUT = "python validation/cuts.py --parts taut"
RANDOM_CUTS = "python validation/cuts.py --parts stability --bodies"
STABILITY = (
    f"{RANDOM_CUTS} box 'generated liver' 'HRA liver'` and `{RANDOM_CUTS} 'SOFA liver' --count 50` and "
    f"`{RANDOM_CUTS} 'generated liver, fine' --count 14"
)


def _cloud(row: Row) -> str:
    """Return the kind of a cloud and whether its cut is oblique."""
    kind = "irregular" if row["jitter"] else "lattice"
    return f"{kind}, oblique" if row.get("normal", [0.0, 0.0, 1.0])[:2] != [0.0, 0.0] else kind


@block("cuts", command=CRACKS)
def cuts_penny(found: Row) -> str:
    """Return the largest errors of opening and energy release of a penny over Poisson's ratios."""
    lines = []
    for radius, cloud in dict.fromkeys((row["radius"], _cloud(row)) for row in found["penny"]):
        rows = [row for row in found["penny"] if (row["radius"], _cloud(row)) == (radius, cloud)]
        errors = [largest(row[name] for row in rows) for name in ("center", "half", "release")]
        lines.append([f"{radius} h", cloud, f"{rows[0]['nodes']:,}", *errors])
    return markdown(["radius", "cloud", "nodes", "opening [%]", "at half the radius", "G"], lines)


@block("cuts", command=STRIPS)
def cuts_strip(found: Row) -> str:
    """Return errors of the energy release of strips, by law, stretch and cloud."""
    cases = list(dict.fromkeys((row["stretch"], _cloud(row)) for row in found["strip"]))
    lines = []
    for law in dict.fromkeys(row["law"] for row in found["strip"]):
        rows = {(row["stretch"], _cloud(row)): row for row in found["strip"] if row["law"] == law}
        lines.append([law, *(signed(rows[case]["release"]) if case in rows else "–" for case in cases)])
    return markdown(["law", *(f"{1 + stretch:g}, {cloud}" for stretch, cloud in cases)], lines)


@block("cuts", command=TROUSERS)
def cuts_trousers(found: Row) -> str:
    """Return release rates of trousers from energies, and from force and stretch of the legs."""
    lines = [
        [
            f"{1e3 * row['height']:.0f} mm", f"{row['stretch']:.2f}",
            *(f"{row[name]:.2f}" for name in ("release", "legs")), signed(row["release"] / row["legs"] - 1),
        ]
        for row in found["trousers"]
    ]  # fmt: skip
    return markdown(["grips", "λ", "−ΔU/ΔA [J/m²]", "2 λ F/t − 2 b W", "difference"], lines)


@block("cuts", command=TAUT)
def cuts_taut(found: Row) -> str:
    """Return errors of the force of a blade in taut tissue, and of what its cut costs, over spacings and speeds."""
    lines = []
    for kind, tension in dict.fromkeys((row["kind"], row["tension"]) for row in found["taut"]):
        rows = [row for row in found["taut"] if (row["kind"], row["tension"]) == (kind, tension)]
        pulled = f"stress {tension:g} Pa" if kind == "edge crack" else f"stretch {1 + tension:g}"
        released = span((share for row in rows for share in row["released"]), lambda share: f"{share:.2f}")
        errors = [span((error for row in rows for error in row[name]), signed) for name in ("force", "cost")]
        lines.append([f"{kind}, {pulled}", released, *errors])
    return markdown(["tissue", "G/Γ", "force", "cost"], lines)


@block("cuts", command=STABILITY)
def cuts_stability(found: Row) -> str:
    """Return what random cuts do to the energy and the stable step of stretched bodies."""
    lines, rows = [], found["stability"]
    for body in dict.fromkeys(row["body"] for row in rows):
        cuts = [row for row in rows if row["body"] == body]
        done = [row for row in cuts if row["stable"]]
        ratios = [row["step_ratio"] for row in done]
        lines.append([
            body, f"{cuts[0]['nodes']:,}", str(len(cuts)), str(len(cuts) - len(done)),
            str(sum(row["growth"] > 0 for row in done)), f"{median(ratios):.2f}", f"{max(ratios):.2f}",
            f"{largest(max(row['changes']) for row in done)} %",
        ])  # fmt: skip
    heads = [
        "body", "nodes", "cuts", "stopped", "made energy", "step, median", "largest",
        "largest rise of the energy by a cut made at once",
    ]  # fmt: skip
    return markdown(heads, lines)
