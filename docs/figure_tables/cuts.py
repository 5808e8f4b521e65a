"""Cuts: forces along them, their opening and energy release, and their stability."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from statistics import median

from figure_tables.cells import Row, block, distinct, markdown, signed

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


def _power(value: float) -> str:
    """Return a small number with one digit and its power of ten."""
    return f"{abs(value):.0e}".replace("e-0", "e-").replace("-", "−")


def _range(change: Row) -> str:
    low, mean, high = (f"{change[name]:+.2f}".replace("-", "−") for name in ("low", "mean", "high"))
    return f"{mean} ({low} to {high})"


@block("cuts", command=CRACKS)
def cuts_patch(found: Row) -> str:
    """Return forces under uniform stress along a cut, and forces and energies of halves that turn apart."""
    lines = [
        [f"stress along a cut {row['place']}", _cloud(row), *(_power(row[name]) for name in ("uncut", "cut", "change"))]
        for row in found["patch"]
    ]
    lines += [["halves turn apart", _cloud(row), "–", _power(row["force"]), "–"] for row in found["halves"]]
    return markdown(["case", "cloud", "uncut", "cut", "change"], lines)


@block("cuts", command=CRACKS)
def cuts_penny(found: Row) -> str:
    """Return errors of opening and energy release of a penny."""
    lines = [
        [
            f"{row['radius']} h", _cloud(row), f"{row['nodes']:,}", f"{row['poisson']:g}",
            *(signed(row[name]) for name in ("center", "half", "release")), f"{row['frequency']:.2f}",
        ]
        for row in found["penny"]
    ]  # fmt: skip
    heads = ["radius", "cloud", "nodes", "ν", "opening", "at half the radius", "G", "highest frequency over uncut"]
    return markdown(heads, lines)


@block("cuts", command=STRIPS)
def cuts_strip(found: Row) -> str:
    """Return errors of the energy release of strips, and what steps of their fronts do at fixed displacements."""
    lines = []
    for row in found["strip"]:
        head = [row["law"], f"{1 + row['stretch']:g}", _cloud(row)]
        steps = [_range(row["changes"][step]) for step in ("0.25", "0.5", "1", "2")]
        lines.append([*head, signed(row["release"]), f"{row['staircase']:.2f} h", *steps])
    heads = ["law", "stretch", "cloud", "G", "staircase", *(f"step {step} h" for step in ("¼", "½", "1", "2"))]
    return markdown(heads, lines)


@block("cuts", command=TROUSERS)
def cuts_trousers(found: Row) -> str:
    """Return release rates of trousers from energies, and from force and stretch of the legs."""
    lines = [
        [
            f"{1e3 * row['height']:.0f} mm", f"{row['stretch']:.2f}", f"{1e3 * row['force']:.1f} mN",
            *(f"{row[name]:.2f} J/m²" for name in ("release", "legs")), signed(row["release"] / row["legs"] - 1),
            f"{row['simple']:.2f} J/m²",
        ]
        for row in found["trousers"]
    ]  # fmt: skip
    return markdown(["grips", "λ", "F", "−ΔU/ΔA", "2 λ F/t − 2 b W", "difference", "2 F/t"], lines)


@block("cuts", command=TAUT)
def cuts_taut(found: Row) -> str:
    """Return errors of the force of a blade in taut tissue, and of what its cut costs."""
    lines = []
    for row in found["taut"]:
        unit = f"{row['tension']:g} Pa" if row["kind"] == "edge crack" else f"{1 + row['tension']:g}"
        low, high = row["released"]
        share = f"{low:.2f}" if high - low < 0.005 else f"{low:.2f} to {high:.2f}"
        errors = [f"{signed(min(row[name]))} to {signed(max(row[name]))}" for name in ("force", "cost")]
        head = [row["kind"], unit, f"{1e3 * row['spacing']:g} mm", f"{row['nodes']:,}", f"{row['speed']:g} m/s"]
        lines.append([*head, share, *errors])
    return markdown(["tissue", "stretch or stress", "h", "nodes", "blade", "G/Γ", "force", "cost"], lines)


@block("cuts", command=STRIPS)
def cuts_moving(found: Row) -> str:
    """Return where the energy goes when the front of a strip moves."""
    lines = [
        [
            _cloud(row), f"{each['step']:g} h",
            *(f"{each[name]:.2f}" for name in ("lost", "at_once", "damped", "kinetic")),
        ]
        for row in found["strip"] for each in row.get("moving", [])
    ]  # fmt: skip
    return markdown(["cloud", "step", "lost", "at fixed displacements", "damped", "kinetic at the end"], lines)


@block("cuts", command=STABILITY)
def cuts_stability(found: Row) -> str:
    """Return what random cuts do to the energy and the stable step of stretched bodies."""
    lines, rows = [], found["stability"]
    for body in dict.fromkeys(row["body"] for row in rows):
        for poisson in distinct((row["poisson"] for row in rows if row["body"] == body), reverse=False):
            cuts = [row for row in rows if row["body"] == body and row["poisson"] == poisson]
            done = [row for row in cuts if row["stable"]]
            ratios = [row["step_ratio"] for row in done]
            lines.append([
                body, f"{cuts[0]['nodes']:,}", f"{poisson:g}", str(len(cuts)), str(len(cuts) - len(done)),
                str(sum(row["growth"] > 0 for row in done)), f"{median(ratios):.2f}", f"{max(ratios):.2f}",
                str(sum(ratio > 1.5 for ratio in ratios)), str(max(row["released"] for row in done)),
            ])  # fmt: skip
    heads = [
        "body", "nodes", "ν", "cuts", "stopped", "made energy", "step, median", "largest", "above 1.5",
        "most nodes released",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("cuts", command=STABILITY)
def cuts_jumps(found: Row) -> str:
    """Return the largest rise of the energy at fixed displacements by a cut made at once."""
    rows, lines = [row for row in found["stability"] if row["stable"]], []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        cells = []
        for body in dict.fromkeys(row["body"] for row in rows):
            changes = [max(row["changes"]) for row in rows if row["body"] == body and row["kind"] == kind]
            cells.append(signed(max(changes)) if changes else "–")
        lines.append([kind, *cells])
    return markdown(["cut", *dict.fromkeys(row["body"] for row in rows)], lines)
