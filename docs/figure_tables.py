"""The tables of the docs, one function each, from the results of docs/validation/*.json. SI units.

`docs/figures.py` calls them. A function takes the results of its files and returns Markdown; its name is the name of
its block in the pages.
"""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

Row = dict[str, Any]
LAYOUTS = (("rings", 0.0), ("hexagonal", 0.0), ("rings", 0.1))
ERRORS = ("displacement", "velocity", "energy", "reaction")
LEAST_SHARE = 1e-5  # smaller shares are below it
LITTLE_FORCE = 0.1  # largest force of a path over that of all, below which a path counts as one of little force


@dataclass(frozen=True)
class Block:
    """A generated part of a page."""

    table: Callable[..., str]  # takes the results of each file
    files: tuple[str, ...]  # names of result files, without .json
    command: str  # that makes them


BLOCKS: dict[str, Block] = {}


def block(*files: str, command: str) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Register a function of results as the block of its name."""

    def register(table: Callable[..., str]) -> Callable[..., str]:
        BLOCKS[table.__name__] = Block(table, files, command)
        return table

    return register


# Cells and tables


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, or more where it has more before the point."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "–"
    if abs(value) >= 10**digits:
        return f"{value:,.0f}".replace("-", "−")
    places = digits - 1 - math.floor(math.log10(float(f"{abs(value):.{digits - 1}e}")))  # 9.99 has those of 10
    return f"{round(value, places):.{max(places, 0)}f}".replace("-", "−")


def percent(value: float, digits: int = 2) -> str:
    """Return a share in per cent, with so many significant digits; from 100 % on without decimals."""
    if 0 < abs(value) < LEAST_SHARE:
        return f"< {100 * LEAST_SHARE:g} %"
    return f"{100 * value:.0f} %" if abs(value) >= 1 else f"{significant(100 * value, digits)} %"


def signed(value: float, places: int = 1, unit: str = " %") -> str:
    """Return a signed error in per cent; what rounds to zero has the sign +."""
    return f"{round(100 * value, places) + 0.0:+.{places}f}{unit}".replace("-", "−")


def microseconds(duration: float) -> str:
    """Return a duration in microseconds."""
    return f"{significant(1e6 * duration)} µs"


def millimetres(spacing: float) -> str:
    """Return a length in millimetres."""
    return f"{significant(1e3 * spacing, 3).rstrip('0').rstrip('.')} mm"


def distinct(values: Iterable[Any], reverse: bool = True) -> list[Any]:
    """Return distinct values in order; spacings from large to small."""
    return sorted(set(values), reverse=reverse)


def find(rows: Iterable[Row], **key: Any) -> Row | None:
    """Return the first row that has these values, numbers to 1e-6 of themselves."""
    return next((row for row in rows if all(_equal(row.get(name), value) for name, value in key.items())), None)


def _equal(one: Any, other: Any) -> bool:
    numbers = isinstance(one, float) and isinstance(other, float)
    return math.isclose(one, other, rel_tol=1e-6) if numbers else one == other


# The paper's examples


BEAM_RUNS = "NUMBA_NUM_THREADS=1 palpate reproduce beam"
MEMBRANE_RUN = "NUMBA_NUM_THREADS=1 palpate reproduce membrane"


def error_cells(errors: Row, kinds: Sequence[str] = ERRORS) -> list[str]:
    """Return errors in per cent."""
    return [percent(errors[kind]) for kind in kinds]


def projected(report: Row) -> dict[int, Row]:
    """Return the projected models of the beam by their number of modes."""
    return {row["modes"]: row for row in report["reduced"] if row["series"] == "projected"}


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45")
def beam_projected(beam: Row, softer: Row) -> str:
    """Return the errors of projected models of the paper's beam at two Poisson's ratios."""
    rows = [
        [
            f"{report['parameters']['poisson']:g}", str(modes), *error_cells(row["errors"]),
            percent(row["projection_error"]), percent(row["ratio"]), f"{row['steps']:,}",
        ]
        for report in (beam, softer) for modes, row in projected(report).items()
    ]  # fmt: skip
    return markdown(["ν", "modes", *ERRORS, "projection", "time / full", "steps"], rows)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45")
def beam_full(beam: Row, softer: Row) -> str:
    """Return the runs of the full models of the paper's beam."""
    rows = []
    for report in (beam, softer):
        for form, run in (("strong", report["full"]), ("energy", report["energy_form"])):
            rows.append([
                f"{report['parameters']['poisson']:g}", form, f"{run['steps']:,}", f"{run['wall_seconds']:.0f} s",
                f"{1e3 * run['peak_tip_displacement']:.0f} mm", f"{run['reaction_at_peak']:.1f} N",
                percent(run["energy_balance"]),
            ])  # fmt: skip
    heads = ["ν", "form", "steps", "computing time", "largest displacement of the end", "support force at 100 N"]
    return markdown([*heads, "largest miss of the energy balance over the largest work"], rows)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45")
def beam_sampled(beam: Row, softer: Row) -> str:
    """Return the errors of sampled models against the energy form, which they reduce."""
    rows = []
    for report in (beam, softer):
        for row in report["reduced"]:
            if row["series"] == "hyper-reduced":
                counts = [f"{report['parameters']['poisson']:g}", str(row["modes"]), str(row["nodes"])]
                rows.append([*counts, *error_cells(row["errors"]), percent(row["ratio"])])
    return markdown(["ν", "modes", "nodes", *ERRORS, "time / full"], rows)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45")
def beam_forms(beam: Row, softer: Row) -> str:
    """Return the difference of the two forms of the full model."""
    rows = []
    for report in (beam, softer):
        forms = report["forms"]
        rows.append([
            f"{report['parameters']['poisson']:g}", *error_cells(forms["errors"]), percent(forms["displacement_until"]),
        ])  # fmt: skip
    return markdown(["ν", *ERRORS, f"displacement until {beam['forms']['until']:g} s"], rows)


def membrane_phase(report: Row, series: str, phase: str) -> dict[int, Row]:
    """Return the reduced membranes of one phase by their number of modes."""
    return {row["modes"]: row["phases"][phase] for row in report["reduced"] if row["series"] == series}


def series_of(report: Row) -> tuple[str, str]:
    """Return the names of the projected and the hyper-reduced series."""
    first, second = dict.fromkeys(row["series"] for row in report["reduced"])
    return first, second


@block("reproduce_membrane", command=MEMBRANE_RUN)
def membrane_projected(report: Row) -> str:
    """Return the errors of projected models of the paper's membrane."""
    return _membrane_table(report, series_of(report)[0])


@block("reproduce_membrane", command=MEMBRANE_RUN)
def membrane_sampled(report: Row) -> str:
    """Return the errors of hyper-reduced models of the paper's membrane."""
    return _membrane_table(report, series_of(report)[1])


def _membrane_table(report: Row, series: str) -> str:
    push, after = (membrane_phase(report, series, phase) for phase in ("push", "after"))
    rows = [
        [
            str(modes), f"{row['nodes']:,}; {after[modes]['nodes']:,}", *error_cells(row["errors"]),
            percent(row["projection_error"]), percent(row["ratio"]), percent(row["error_at_end"]),
            percent(after[modes]["errors"]["displacement"]), percent(after[modes]["projection_error"]),
            percent(after[modes]["ratio"]),
        ]
        for modes, row in push.items()
    ]  # fmt: skip
    heads = [
        "modes", "nodes or points: push; after", "push: displacement (34)", "velocity", "energy", "tool force",
        "projection", "time / full", "displacement at 0.1 s", 'after "return": displacement', "projection",
        "time / full",
    ]  # fmt: skip
    return markdown(heads, rows)


# The README


def displacements(rows: dict[int, Row], *sizes: int) -> str:
    """Return the displacement errors of models of some numbers of modes."""
    return "; ".join(percent(rows[modes]["errors"]["displacement"]) for modes in sizes)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45")
def beam_claims(beam: Row, softer: Row) -> str:
    """Return the paper's claims on the beam next to what was measured."""
    both = [projected(report) for report in (beam, softer)]
    several = ("velocity", "energy", "reaction")
    rows = [
        ["displacement error (34) with 6 modes", "< 3 %", *(displacements(each, 6) for each in both)],
        ["with 8 modes; with 12", "slight decrease after 8", *(displacements(each, 8, 12) for each in both)],
        [
            "velocity / energy / reaction-force error, 12 modes", "–",
            *(" / ".join(error_cells(each[12]["errors"], several)) for each in both),
        ],
        ["time over the full model's, 8 modes", "3 %", *(percent(each[8]["ratio"]) for each in both)],
    ]  # fmt: skip
    heads = ["", "paper", *(f"ν = {report['parameters']['poisson']:g}" for report in (beam, softer))]
    return markdown(heads, rows)


@block("reproduce_membrane", command=MEMBRANE_RUN)
def membrane_claims(report: Row) -> str:
    """Return the paper's claims on the membrane next to what was measured while the tool pushes."""
    plain, sampled = (membrane_phase(report, series, "push") for series in series_of(report))
    last = " / ".join(error_cells(plain[12]["errors"], ("energy", "reaction")))

    points = "; ".join(str(sampled[modes]["nodes"]) for modes in (2, 8, 12))
    rows = [
        ["displacement error (34) with 2; 8; 12 modes", "high; very small; as with 8", displacements(plain, 2, 8, 12)],
        [f"the same, hyper-reduced to {points} points", "–", displacements(sampled, 2, 8, 12)],
        ["the same at 0.1 s alone, 8; 12 modes", "–", "; ".join(percent(plain[m]["error_at_end"]) for m in (8, 12))],
        ["energy / tool-force error, 12 modes", "–", last],
        [
            "time over the full model's, 8 modes; hyper-reduced", "dramatically less",
            "; ".join(percent(rows[8]["ratio"]) for rows in (plain, sampled)),
        ],
    ]  # fmt: skip
    return markdown(["", "paper", "here"], rows)


def bench_rows(bench: Row) -> list[list[str]]:
    """Return what `palpate bench` measured of reduced models."""
    beam, large = bench["beam"][0], bench["large"]
    fast, bodies = beam["hyper_reduced"], large["bodies"]
    pull = "; ".join(percent(fast["ratio"][form]) for form in ("strong", "energy"))
    return [
        [
            f"beam, {beam['nodes']:,} nodes: a step of {fast['modes']} modes at {fast['nodes']} sampled nodes",
            microseconds(fast["compiled_seconds_per_step"]),
        ],
        ["the paper's pull, over the full model's time: strong form; energy form (paper: 3 %)", pull],
        [
            f"a force evaluation of {large['modes']} modes at {large['nodes']} sampled nodes",
            microseconds(large["force_seconds"]),
        ],
        [
            "the same over reading its operators from memory; from the cache",
            f"{large['force_over_memory_reading']:.1f}; {large['force_over_reading']:.1f}",
        ],
        [
            f"a step of that model trained on {bodies[1]['nodes']:,} nodes over one trained on {bodies[0]['nodes']:,}",
            f"{large['compiled_step_ratio']:.2f}",
        ],
    ]  # fmt: skip


@block("bench", command="palpate bench")
def bench_models(bench: Row) -> str:
    """Return the speed of full and reduced models."""
    beam, full = bench["beam"][0], bench["full_body"]
    rows = [
        [
            f"beam, {beam['nodes']:,} nodes: full model, {form} form",
            f"{run['steps_per_second']:,.0f} steps/s, {significant(run['real_time_factor'])} of real time",
        ]
        for form, run in beam["full"].items()
    ]  # fmt: skip
    rows += [
        [
            f"full liver of {full['nodes']:,} nodes under a ball, {run['threads']} threads: a period of 1 ms, mean; "
            "median; 99 %",
            "; ".join(f"{1e3 * run[name]:.2f}" for name in ("mean_seconds", "median_seconds", "seconds_99")) + " ms",
        ]
        for run in full["threads"]
    ]  # fmt: skip
    return markdown(["quantity, medians of 3 rounds", "here"], [*bench_rows(bench), *rows])


@block(
    "organ_models", "bench", "reproduce_beam", "held_out",
    command=f"python validation/organ_models.py`, `palpate bench`, `{BEAM_RUNS}` and "
    "`python validation/held_out.py",
)  # fmt: skip
def readme_figures(organs: list[Row], bench: Row, beam: Row, studies: Row) -> str:
    """Return the six figures of the README, each with the command that makes it."""
    first, errors = ([select(organ) for organ in organs] for select in (_first_force, _small_model_force))
    full, fast = max(bench["full_body"]["threads"], key=lambda run: run["nodes_in_real_time"]), bench["beam"][0]
    full_nodes = bench["full_body"]["nodes"]
    runs = [row[rule] for row in studies["stability"] for rule in ("explicit", "implicit")]
    six, eight = projected(beam)[6], find(beam["reduced"], series="hyper-reduced", modes=8)
    organ_command, bench_command = "`python validation/organ_models.py`", "`palpate bench`"
    rows = [
        [
            f"from a surface to the first force on the tool, median of {len(organs)} organs; the one that compiled",
            f"{sorted(first)[len(first) // 2]:.0f} s; {max(first):.0f} s", organ_command,
        ],
        [
            f"nodes of a full body in real time under a ball, by the mean period of {full_nodes:,} nodes",
            f"{100 * round(full['nodes_in_real_time'] / 100):,}", bench_command,
        ],
        [
            "force on the tool of organs trained with default choices, median error on unseen paths",
            f"{percent(min(errors))} to {percent(max(errors))}", organ_command,
        ],
        [
            f"a step of the reduced beam, {fast['hyper_reduced']['modes']} modes",
            microseconds(fast["hyper_reduced"]["compiled_seconds_per_step"]), bench_command,
        ],
        [
            "the paper's beam: error (34) projected, 6 modes (paper: < 3 %); sampled, 8 modes, and its time",
            f"{displacement(six)}; {displacement(eight)}, {percent(eight['ratio'])} of the full model's",
            f"`{BEAM_RUNS}`",
        ],
        [
            f"runs of reduced models into buckling that diverged, {studies['stability'][0]['modes']} to "
            f"{studies['stability'][-1]['modes']} modes",
            f"{sum(run['failed'] for run in runs)} of {sum(run['runs'] for run in runs)}",
            "`python validation/held_out.py`",
        ],
    ]  # fmt: skip
    return markdown(["figure", "here", "command"], rows)


def _first_force(organ: Row) -> float:
    return organ["new"] + organ["first_force"]


def _small_model_force(organ: Row) -> float:
    return organ["small"]["force"]


def displacement(entry: Row) -> str:
    """Return the displacement error of a reduced run."""
    return percent(entry["errors"]["displacement"])


# Statics and frequencies


@block("tips", command="python validation/tips.py")
def tips(rows: list[Row]) -> str:
    """Return the error of the mean displacement of the beam's end, by load, form and spacing."""
    columns = [
        ("energy form, 5 mm", {"form": "energy", "spacing": 0.005}),
        ("energy form, 4 mm", {"form": "energy", "spacing": 0.004}),
        ("strong form, 5 mm", {"form": "strong", "pressure": "split", "spacing": 0.005}),
        ("strong form, 3.3 mm", {"form": "strong", "pressure": "split", "spacing": 0.0033333333}),
        ("strong form, 2.5 mm", {"form": "strong", "pressure": "split", "spacing": 0.0025}),
        ("direct pressure, 5 mm", {"form": "strong", "pressure": "direct", "spacing": 0.005}),
    ]
    lines = []
    for kind in ("axial", "sideways"):
        for poisson in (0.3, 0.45, 0.49):
            for force in distinct((row["force"] for row in rows if row["kind"] == kind), reverse=False):
                found = [find(rows, kind=kind, poisson=poisson, force=force, **key) for _, key in columns]
                # the direct pressure has no static state at 0.49
                gaps = ["not run"] * 5 + ["unstable" if kind == "sideways" and poisson == 0.49 else "not run"]
                cells = [f"{row['error']:.2%}" if row else gap for row, gap in zip(found, gaps, strict=True)]
                lines.append([f"{kind} {force:g} N", f"{poisson:g}", *(cell.replace("%", " %") for cell in cells)])
    return markdown(["load", "ν", *(head for head, _ in columns)], lines)


@block("frequencies", command="python validation/frequencies.py")
def frequencies_strong(rows: list[Row]) -> str:
    """Return the errors of the first bending and axial frequency of the strong form."""
    columns = [("split", h) for h in (0.02 / 3, 0.005, 0.004)] + [("direct", h) for h in (0.005, 0.004)]
    heads = [f"{'direct pressure, ' if pressure == 'direct' else ''}{millimetres(h)}" for pressure, h in columns]
    lines = []
    for poisson in (0.3, 0.45, 0.49):
        found = [find(rows, form="strong", pressure=p, poisson=poisson, spacing=h) for p, h in columns]
        lines.append([f"{poisson:g}", *(_frequency_errors(row) for row in found)])
    return markdown(["ν", *heads], lines)


def _frequency_errors(row: Row) -> str:
    negative = f" ({row['negative']})" if row["negative"] else ""
    return f"{signed(row['bending_error'], unit='')} / {signed(row['axial_error'])}{negative}"


@block("frequencies", command="python validation/frequencies.py --forms energy")
def frequencies_energy(rows: list[Row]) -> str:
    """Return the errors of the first bending, torsion and axial frequency of the energy form."""
    spacings = (0.02 / 3, 0.005, 0.004)
    lines = []
    for poisson in (0.3, 0.45, 0.49):
        found = [find(rows, form="energy", poisson=poisson, spacing=h) for h in spacings]
        cells = [
            " / ".join(signed(row[f"{kind}_error"], unit="") for kind in ("bending", "torsion", "axial")) + " %"
            for row in found
        ]
        lines.append([f"{poisson:g}", *cells])
    return markdown(["ν", *map(millimetres, spacings)], lines)


# The membrane


@block("membrane_reduction", command="python validation/membrane_reduction.py")
def membrane_lifting(rows: list[Row]) -> str:
    """Return the displacement error of reduced membranes by lifting, snapshots and basis."""
    sizes = distinct((row["modes"] for row in rows), reverse=False)
    lines = []
    for training, basis in dict.fromkeys((row["training"], row["basis"]) for row in rows):
        lifting, _, snapshots = training.partition(" lifting")
        push = [find(rows, then="hold", training=training, basis=basis, modes=size)["push"] for size in sizes]
        cells = [_displacements(push)]
        for then in ("hold", "release", "return"):
            runs = [find(rows, then=then, training=training, basis=basis, modes=size) for size in sizes]
            if any(run is None for run in runs):
                cells.append("not run")
            else:
                after = [run["after"] for run in runs]
                cells.append(_displacements(after))
        lines.append([lifting, "relative" if snapshots else "as they are", basis, *cells])
    heads = ["lifting of the tool", "snapshots", "basis", "push", 'after "hold"', 'after "release"', 'after "return"']
    return markdown(heads, lines)


def _displacements(errors: list[Row]) -> str:
    values = [error["displacement"] for error in errors]
    if all(error["energy"] > 10 for error in errors):
        return f"energy {min(error['energy'] for error in errors):.0f} times too large or more"
    return " / ".join(percent(value)[:-2] for value in values) + " %"


@block("membranes", command="python validation/membranes.py frequencies")
def membrane_frequencies(studies: Row) -> str:
    """Return the largest error of the first four frequencies of a taut sheet."""
    lines = []
    for form in ("energy", "strong"):
        for spacing in (0.01, 0.005):
            cells = []
            for layout, jitter in LAYOUTS:
                key = {"form": form, "spacing": spacing, "layout": layout, "jitter": jitter}
                rows = [row for row in studies["frequencies"] if all(row[k] == v for k, v in key.items())]
                cells.append(percent(max(abs(error) for row in rows for error in row["errors"])))
            lines.append([form, millimetres(spacing), *cells])
    return markdown(["form", "spacing", "rings", "triangular", "rings, jitter 0.1"], lines)


@block("membranes", command="python validation/membranes.py statics")
def membrane_pushed(studies: Row) -> str:
    """Return the errors of the tool's force and of the mean deflection of a pushed sheet."""
    rows = [row for row in studies["statics"] if row["case"] == "poke"]
    lines = []
    for prestretch, radius, form in dict.fromkeys((r["prestretch"], r["tool_radius"], r["form"]) for r in rows):
        taut = f"{prestretch:g}" if prestretch > 1 else "none"
        for spacing in distinct(row["spacing"] for row in rows):
            key = {"prestretch": prestretch, "tool_radius": radius, "form": form, "spacing": spacing}
            found = [find(rows, **key, layout=layout, jitter=jitter) for layout, jitter in LAYOUTS]
            cells = [f"{signed(row['force_error'], unit='')} / {signed(row['mean_error'])}" for row in found]
            lines.append([f"{millimetres(radius)}, {taut}, {form}", millimetres(spacing), *cells])
    heads = ["tool radius, prestretch, form", "spacing", "rings", "triangular", "rings, jitter 0.1"]
    return markdown(heads, lines)


@block("membranes", command="python validation/membranes.py statics")
def membrane_inflated(studies: Row) -> str:
    """Return the error of the height of an inflated sheet."""
    rows = [row for row in studies["statics"] if row["case"] == "inflation"]
    lines = []
    for pressure in distinct((row["pressure"] for row in rows), reverse=False):
        exact = find(rows, pressure=pressure)
        height = 1e3 * exact["height"] / (1 + exact["height_error"])
        for spacing in distinct(row["spacing"] for row in rows):
            found = [find(rows, pressure=pressure, spacing=spacing, layout=a, jitter=b) for a, b in LAYOUTS]
            cells = [signed(row["height_error"], 2) for row in found]
            lines.append([f"{pressure:g} Pa ({height:.2f} mm)", millimetres(spacing), *cells])
    return markdown(["pressure (height)", "spacing", "rings", "triangular", "rings, jitter 0.1"], lines)


@block("membranes", command="python validation/membranes.py nodes")
def membrane_nodes(studies: Row) -> str:
    """Return the radius of the disc that needs the force of a single pushed node."""
    rows = studies["nodes"]
    lines = []
    for spacing in distinct(row["spacing"] for row in rows):
        found = [find(rows, spacing=spacing, layout=layout) for layout in ("rings", "hexagonal")]
        cells = [f"{row['radius_in_spacings']:.2f}; {signed(row['mean_error'], 2)}" for row in found]
        lines.append([millimetres(spacing), *cells])
    return markdown(["spacing", "rings: radius in spacings; mean deflection", "triangular: the same"], lines)


@block("membranes", command="python validation/membranes.py layouts")
def membrane_layouts(studies: Row) -> str:
    """Return the mean deflection of a pushed sheet at 0.1 s on all layouts."""
    rows = studies["layouts"]
    lines = []
    for radius in distinct(row["tool_radius"] for row in rows):
        for spacing in distinct(row["spacing"] for row in rows):
            found = [
                find(rows, tool_radius=radius, spacing=spacing, layout=layout, jitter=jitter)
                for layout, jitter in (*LAYOUTS, ("hexagonal", 0.1))
            ]
            tool = millimetres(radius) if radius else "one node"
            lines.append([tool, millimetres(spacing), *(f"{1e3 * row['mean_deflection']:.2f} mm" for row in found)])
    return markdown(["tool", "spacing", "rings", "triangular", "rings, jitter 0.1", "triangular, jitter 0.1"], lines)


@block("membranes", command="python validation/membranes.py stability")
def membrane_stability(studies: Row) -> str:
    """Return energies and balances of the runs of the sheet."""
    rows = studies["stability"]
    lines = []
    for spacing in distinct(row["spacing"] for row in rows):
        own = [row for row in rows if row["spacing"] == spacing]
        lines.append([
            millimetres(spacing), ", ".join(f"{n:,}" for n in distinct((r["nodes"] for r in own), reverse=False)),
            str(len(own)), percent(max(row["growth_after"] for row in own)),
            percent(max(row["miss_pushing"] for row in own)),
            percent(max(row["largest_wrinkled_share"] for row in own)),
        ])  # fmt: skip
    heads = [
        "spacing", "nodes", "runs", "largest growth of energy after the tool's last motion",
        "largest miss of the balance while the tool pushes", "largest wrinkled share",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("axisymmetric", command="python validation/axisymmetric_table.py")
def axisymmetric(found: Row) -> str:
    """Return forces and heights of the axisymmetric solutions, and their difference from finite elements."""
    lines = [
        [
            f"pushed by {1e3 * row['height']:g} mm, tool of {1e3 * row['tool_radius']:g} mm, "
            f"prestretch {row['prestretch']:g}", f"{1e3 * row['force']:.4f} mN",
            f"{1e3 * row['mean_deflection']:.3f} mm", f"{row['elements_difference']:.0e}",
        ]
        for row in found["poke"]
    ]  # fmt: skip
    lines += [
        [
            f"inflated by {row['pressure']:g} Pa", f"height {1e3 * row['height']:.2f} mm",
            f"{1e3 * row['mean_deflection']:.3f} mm", f"{row['elements_difference']:.0e}",
        ]
        for row in found["inflate"]
    ]  # fmt: skip
    return markdown(["case", "force or height", "mean deflection", "difference from 400 finite elements"], lines)


# The sampled model


def _errors(found: Row, statistic: str) -> str:
    return " / ".join(significant(100 * found[kind][statistic], 2) for kind in ERRORS)


@block("held_out", command="python validation/held_out.py accuracy")
def held_out_accuracy(studies: Row) -> str:
    """Return the errors of sampled models on motions that they were not trained on, 95th percentile."""
    lines = []
    for row in studies["accuracy"]:
        sets = [_errors(row["sets"][name], "percentile_95") for name in ("inside", "outside", "buckling")]
        lines.append([str(row["modes"]), str(row["report"]["nodes"]), *sets])
    nodes = studies["accuracy"][0]["report"]["nodes_full"]
    return markdown(["modes", f"nodes of {nodes:,}", "inside", "outside", "buckling"], lines)


@block("held_out", command="python validation/held_out.py accuracy")
def held_out_medians(studies: Row) -> str:
    """Return the median errors on motions inside, and the errors over a whole run."""
    lines = []
    for row in studies["accuracy"]:
        inside = row["sets"]["inside"]
        over = [significant(100 * inside[f"{kind}_rms"]["percentile_95"], 2) for kind in ("displacement", "velocity")]
        failed = sum(each["failed"] for each in row["sets"].values())
        runs = sum(each["runs"] for each in row["sets"].values())
        lines.append([str(row["modes"]), _errors(inside, "median"), " / ".join(over), f"{failed} of {runs}"])
    return markdown(["modes", "median, inside", "whole run, 95th percentile: displacement / velocity", "failed"], lines)


@block("held_out", command="python validation/held_out.py trust")
def held_out_trust(studies: Row) -> str:
    """Return Spearman's correlation of the error with the distance, the residual norm and the trust number."""
    names = ("distance", "residual norm", "trust")
    columns = [("all", "so_far"), ("all", "now"), ("all", "of_runs")]
    columns += [(name, "so_far") for name in ("inside", "outside", "buckling")]
    lines = []
    for row in studies["trust"]:
        cells = [" / ".join(f"{row[of][f'{name}_{when}']:.2f}" for name in names) for of, when in columns]
        lines.append([str(row["modes"]), *cells])
    heads = [
        "modes", "all 20 runs, number so far", "number of the moment", "largest number and error of each run",
        "inside, so far", "outside, so far", "buckling, so far",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("held_out", command="python validation/held_out.py stability")
def held_out_stability(studies: Row) -> str:
    """Return failures and the worst balance of energy by number of modes and step rule."""
    lines = []
    for row in studies["stability"]:
        cells = [
            f"{row[rule]['failed']} of {row[rule]['runs']}; {percent(row[rule]['worst_balance'], 1)}"
            for rule in ("explicit", "implicit")
        ]
        lines.append([str(row["modes"]), str(row["nodes"]), *cells])
    heads = [
        "modes",
        "nodes",
        "explicit: failed; largest miss of the balance over the work",
        "implicit, 1 ms: the same",
    ]
    return markdown(heads, lines)


@block("held_out", command="python validation/held_out.py stepping")
def held_out_stepping(studies: Row) -> str:
    """Return the cost and the errors of steps."""
    lines = [
        [
            str(row["modes"]), row["rule"], f"{significant(1e3 * row['step'])} ms", significant(row["seconds"]),
            percent(row["velocity_error"]), percent(row["displacement_error"]),
        ]
        for row in studies["stepping"]["cost"]
    ]  # fmt: skip
    heads = ["modes", "rule", "step", "seconds", "velocity error of the steps", "displacement error"]
    return markdown(heads, lines)


@block("held_out", command="python validation/held_out.py enrichment")
def held_out_enrichment(studies: Row) -> str:
    """Return the errors of bases of 32 fields on motions inside."""
    lines = [[row["basis"], _errors(row["inside"], "percentile_95")] for row in studies["enrichment"]]
    return markdown(["basis", "inside"], lines)


@block("held_out", command="python validation/held_out.py sampling")
def held_out_sampling(studies: Row) -> str:
    """Return the displacement errors of other samplings."""
    kinds = ("sampled energy", "all nodes", "plain force sampling", "Q-DEIM")
    lines = []
    for row in studies["sampling"]:
        cells = [percent(row[kind]) if math.isfinite(row[kind]) else "diverged" for kind in kinds]
        motion = "trained" if row["run"].startswith("train") else "inside"
        lines.append([f"{row['modes']}, {row['nodes']}", motion, *cells])
    heads = ["modes, nodes", "motion", "sampled energy", "all nodes", "nodal forces, positive weights", "Q-DEIM"]
    return markdown(heads, lines)


@block("large_training", command="python validation/large_training.py")
def large_training(rows: list[Row]) -> str:
    """Return time and memory of a training at many nodes."""
    lines = [
        [
            f"{row['nodes']:,}", str(row["modes"]), f"{row['seconds']:.0f} s", f"{row['gigabytes']:.1f} GB",
            f"{row['gigabytes_before']:.1f} GB", str(row["sampled"]),
        ]
        for row in rows
    ]  # fmt: skip
    return markdown(["nodes", "modes", "time", "peak memory", "of it before the training", "sampled nodes"], lines)


# Steps, coverage, organs of real-time spacing


@block("stable_step", command="python validation/stable_step.py")
def stable_step_limits(found: Row) -> str:
    """Return what limits the stable step of four bodies."""
    lines = [
        [
            f"{row['body']}, {row['nodes']:,} nodes", f"{row['frequency_over_wave']:.2f}",
            f"{row['share_of_four']:.0%}, {row['mass_of_four']:.2f}".replace("%", " %"),
            f"{row['largest_step']:.2f}", f"{row['step_with_least_mass']['0.25']:.2f}",
        ]
        for row in found["limits"]
    ]  # fmt: skip
    heads = [
        "body", "highest frequency, over that of a wave of two spacings",
        "four fastest nodes: share of the vibration, mass over the median", "largest stable step over that of runs",
        "step with masses of at least a quarter of the median, over the step",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("stable_step", command="python validation/stable_step.py --filled")
def stable_step_filled(found: Row) -> str:
    """Return the stable steps of filled bodies without and with transfers of weight."""
    lines = [
        [
            row["body"], f"{row['nodes']:,}", *(f"{1e6 * step:.0f}" for step in row["steps"]),
            f"{row['steps'][1] / row['steps'][0]:.2f}", signed(row["frequency_change"], 2),
            signed(row["displacement_change"], 2),
        ]
        for row in found["filled"]
    ]  # fmt: skip
    heads = [
        "body", "nodes", "step without transfers [µs]", "with [µs]", "ratio", "first frequency", "displacement",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("coverage", command="python validation/coverage.py")
def coverage(rows: list[Row]) -> str:
    """Return how many further runs keep their error bounds."""
    lines = [
        [
            row["body"], str(row["modes"]), row["of"], f"{100 * row['kept']:.1f} %", f"{100 * row['unknown']:.1f} %",
            percent(row["error"]), f"{row['bound over error']:.1f}", f"{row['rank correlation']:.2f}",
        ]
        for row in rows
    ]  # fmt: skip
    lines.append(["mean of all", "", "", f"{100 * mean(row['kept'] for row in rows):.1f} %", "", "", "", ""])
    heads = [
        "body", "modes", "error of", "runs kept", "unknown", "median largest error of a run",
        "last bound over largest error, median", "rank correlation of largest number and error",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("spacing_force", command="python validation/spacing_force.py")
def organ_force(rows: list[Row]) -> str:
    """Return the force of a ball on livers of real-time spacing next to that on finer ones."""
    lines = []
    for row in rows:
        (coarse, fine), ball = row["force"], (1e3 * row["radius"], 1e3 * row["depth"])
        lines.append([
            row["organ"], ", ".join(f"{nodes:,}" for nodes in row["nodes"]),
            ", ".join(significant(length, 3) for length in ball),
            f"{math.sqrt(row['radius'] * row['depth']) / row['spacing']:.1f}",
            ", ".join(significant(force, 3) for force in (coarse, fine)), signed(coarse / fine - 1),
            ", ".join(signed(drift) for drift in row["drift"]),
        ])  # fmt: skip
    errors = [abs(row["force"][0] / row["force"][1] - 1) for row in rows]
    lines.append(["median; largest", "", "", "", "", f"{100 * median(errors):.1f}; {100 * max(errors):.1f} %", ""])
    heads = [
        "organ", "nodes", "radius of the ball, depth [mm]", "contact radius / spacing", "force [N]", "error", "drift",
    ]  # fmt: skip
    return markdown(heads, lines)


# Linear reductions

MAX_ERROR = 10.0  # larger errors are printed as larger than this


@block("compare_beam", command="palpate compare beam --modes 4 8 16 24")
def linear_beam(report: Row) -> str:
    """Return the errors of linear models [%] under a small and a large load, and of their frequency response."""
    about = report["parameters"]
    entries = [entry | {"method": f"`{entry['method']}`"} for entry in report["methods"]]
    entries += [entry | {"method": report["nonlinear"]["name"]} for entry in report["nonlinear"]["entries"]]
    sizes = distinct((entry["modes"] for entry in entries), reverse=False)
    lines = []
    for method in dict.fromkeys(entry["method"] for entry in entries):
        own = {entry["modes"]: entry for entry in entries if entry["method"] == method}
        last = own.get(sizes[-1])
        small = [_linear_error(own.get(size), "small", "displacement") for size in sizes]
        responses = [_bounded(own[size].get("response_error")) if size in own else "–" for size in sizes]
        kinds = [_linear_errors(last, load, kinds) for load, kinds in (("small", ERRORS[1:]), ("large", ERRORS))]
        response = "" if set(responses) == {"–"} else " / ".join(responses)
        lines.append([method, " / ".join(small), kinds[0], response, kinds[1]])
    names = ", ".join(map(str, sizes))
    small_load, large_load = (f"{about[load]:g} {about['unit']}" for load in ("small", "large"))
    heads = [
        "method", f"{small_load}: displacement with {names} modes", f"velocity / energy / force, {sizes[-1]}",
        f"frequency response, {names} modes", f"{large_load}: displacement / velocity / energy / force",
    ]  # fmt: skip
    return markdown(heads, lines)


def _linear_errors(entry: Row | None, load: str, kinds: Sequence[str]) -> str:
    errors = [_linear_error(entry, load, kind) for kind in kinds]
    return errors[0] if errors[0] in ("failed", "diverged") else " / ".join(errors)


def _linear_error(entry: Row | None, load: str, kind: str) -> str:
    if entry is None or entry["failed"]:
        return "failed"
    errors = entry["errors"][load]
    return "diverged" if errors is None else _bounded(errors[kind])


def _bounded(error: float | None) -> str:
    if error is None:
        return "–"
    return f"> {100 * MAX_ERROR:.0f}" if error > MAX_ERROR else significant(100 * error)


# Contact


@block("contact", command="python validation/contact.py")
def contact_ball(rows: list[Row]) -> str:
    """Return the error of the force on a ball against finite elements."""
    columns = [
        ("energy, 3 mm", "energy", 0.003, False, 0.0), ("aside", "energy", 0.003, False, 0.5),
        ("filled", "energy", 0.003, True, 0.0), ("energy, 2 mm", "energy", 0.002, False, 0.0),
        ("aside", "energy", 0.002, False, 0.5), ("filled", "energy", 0.002, True, 0.0),
        ("strong, 3 mm", "strong", 0.003, False, 0.0), ("strong, 2 mm", "strong", 0.002, False, 0.0),
    ]  # fmt: skip
    radius = 0.02
    lines = []
    for exact in [row for row in rows if row["tool"] == "ball" and row["form"] == "finite elements"]:
        depth = exact["depth"]
        contact_radius = math.sqrt(radius * depth) / 0.002
        cells = []
        for _, form, spacing, filled, shift in columns:
            found = find(rows, tool="ball", form=form, spacing=spacing, filled=filled, shift=shift, depth=depth)
            cells.append(signed(found["force"] / exact["force"] - 1))
        lines.append([f"{100 * depth / radius:.0f} % ({contact_radius:.1f})", *cells])
    return markdown(["indentation, of the radius", *(column[0] for column in columns)], lines)


@block("contact", command="python validation/contact.py --tools punch --spacings 0.003")
def contact_punch(rows: list[Row]) -> str:
    """Return the error of the force on a flat punch against finite elements."""
    punch = [row for row in rows if row["tool"] == "punch"]
    exact = next(row for row in punch if row["form"] == "finite elements")
    lines = [
        [
            f"{row['form']}, {millimetres(row['spacing'])}",
            "filled" if row["filled"] else "between nodes" if row["shift"] else "over a node",
            millimetres(row["depth"]), signed(row["force"] / exact["force"] - 1),
        ]
        for row in punch if row is not exact
    ]  # fmt: skip
    return markdown(["form, spacing", "nodes under the punch", "depth", "error of the force"], lines)


@block("contact", command="python validation/contact.py --tools ball")
def contact_noise(rows: list[Row]) -> str:
    """Return the noise of the force and the gap in the balance of energy."""
    columns = [("energy", 0.003), ("energy", 0.002), ("strong", 0.003), ("strong", 0.002)]
    found = [find(rows, tool="ball", form=form, spacing=h, filled=False, shift=0.0) for form, h in columns]
    lines = [
        ["noise of the force at 1 kHz, of the largest force", *(percent(row["noise"], 1) for row in found)],
        ["largest gap in the balance of energy, of the tool's work", *(percent(row["balance"]) for row in found)],
    ]
    return markdown(["what", *(f"{form}, {millimetres(h)}" for form, h in columns)], lines)


@block("contact", command="python validation/contact.py --tools --spacings --overhead")
def contact_overhead(rows: list[Row]) -> str:
    """Return what a ball adds to a step."""
    row = find(rows, tool="overhead")
    cells = [
        f"{row['nodes']:,}", f"{row['surface']:,}", str(row["touching"]), f"{row['step_ms']:.2f} ms",
        f"{1e3 * row['contact_ms']:.0f} µs", percent(row["share"]),
    ]  # fmt: skip
    return markdown(["nodes", "of the surface", "pushed", "step", "the ball adds", "share of the step"], [cells])


PRESS_NAMES = {
    "force": "force on the tool against the full model's of the moment, median",
    "force_95": "the same, 95th percentile",
    "surface_95": "surface displacement against the largest, 95th percentile of nodes and frames",
    "farthest_95": "the same of the farthest node",
}


@block("presses", command="python validation/presses.py out/train")
def presses(entries: list[Row]) -> str:
    """Return the errors of a reduced liver on presses and grasps that it was not trained on."""
    rows = entries[-1]["presses"]
    kinds = {kind: [row for row in rows if row["kind"] == kind] for kind in ("press", "grasp")}
    lines = []
    for name, words in PRESS_NAMES.items():
        cells = []
        for own in kinds.values():
            values = [100 * row[name] for row in own]
            cells.append("; ".join(significant(value(values)) for value in (mean, median, max)) + " %")
        lines.append([words, *cells, percent(mean(row[name] for row in rows))])
    counts = [f"{len(kinds['press'])} presses", f"{len(kinds['grasp'])} grasps"]
    return markdown(["", *(f"{count}: mean; median; worst" for count in counts), "mean of all"], lines)


@block("presses", command="python validation/presses.py out/train")
def presses_kept(entries: list[Row]) -> str:
    """Return how many held-out paths keep each aim."""
    aims = {"force": 0.05, "force_95": 0.1, "surface_95": 0.05}
    rows = entries[-1]["presses"]
    lines = []
    for name, aim in aims.items():
        cells = []
        for kind in ("press", "grasp"):
            own = [row for row in rows if row["kind"] == kind]
            cells.append(f"{sum(row[name] < aim for row in own)} of {len(own)}")
        lines.append([PRESS_NAMES[name], percent(aim, 1), *cells])
    return markdown(["error", "aim", "presses that keep it", "grasps that keep it"], lines)


# Nearly incompressible blocks

CASES = ("tension", "compression", "bending", "torsion")


def _error_or_gap(rows: list[Row], **key: Any) -> str:
    found = find(rows, **key)
    return signed(found["error"], unit="") if found else "not run"


@block("incompressible", command="python validation/incompressible.py blocks` and `... cook")
def incompressible_energy(found: Row) -> str:
    """Return the errors of the energy form on blocks and Cook's slab, lattice and jittered cloud."""
    lines = []
    for case in (*CASES, "cook"):
        for poisson in (0.49, 0.499):
            cells = []
            for spacing in (0.005, 0.004, 0.0025):
                key = {"case": case, "poisson": poisson, "form": "energy", "spacing": spacing}
                pair = [_error_or_gap(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
                cells.append("not run" if pair == ["not run"] * 2 else " / ".join(pair) + " %")
            lines.append(["Cook's slab" if case == "cook" else case, f"{poisson:g}", *cells])
    return markdown(["case", "ν", "5 mm", "4 mm", "2.5 mm"], lines)


@block("incompressible", command="python validation/incompressible.py blocks --forms strong")
def incompressible_strong(found: Row) -> str:
    """Return the errors of the strong form with its split pressure on blocks."""
    columns = [(0.49, 0.005), (0.49, 0.004), (0.499, 0.005)]
    lines = []
    for case in CASES:
        cells = []
        for poisson, spacing in columns:
            key = {"case": case, "poisson": poisson, "form": "strong", "spacing": spacing}
            cells.append(" / ".join(_error_or_gap(found["rows"], **key, jitter=j) for j in (0.0, 0.2)) + " %")
        lines.append([case, *cells])
    return markdown(["case", *(f"{poisson:g}, {millimetres(h)}" for poisson, h in columns)], lines)


@block("incompressible", command="python validation/incompressible.py blocks` and `... shown")
def incompressible_pressures(found: Row) -> str:
    """Return checkerboards and errors of pressures at 2.5 mm."""
    lines = []
    for case in CASES:
        for poisson in (0.49, 0.499):
            key = {"case": case, "poisson": poisson, "spacing": 0.0025, "form": "energy"}
            pair = [find(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
            shown = [find(found["shown"], case=case, poisson=poisson, jitter=jitter) for jitter in (0.0, 0.2)]
            values = [
                [row["rough"][2] for row in pair], [row["rough"][1] for row in pair], [row["rough"] for row in shown],
                [row["pressure_errors"][1] for row in pair], [row["pressure_errors"][0] for row in shown],
            ]  # fmt: skip
            cells = [" / ".join(f"{value:.0f}" for value in each) for each in values]
            lines.append([case, f"{poisson:g}", *cells, f"{shown[0]['range']:.0f}"])
    heads = [
        "case", "ν", "board, each node's own J", "board, in the stress", "board, recovered",
        "difference, in the stress", "difference, recovered", "range",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("incompressible", command="python validation/incompressible.py blocks")
def incompressible_steps(found: Row) -> str:
    """Return the stable step at rest of the block."""
    lines = []
    for form, spacings in (("energy", (0.005, 0.004, 0.0025)), ("strong", (0.005, 0.004))):
        for spacing in spacings:
            cells = []
            for poisson in (0.49, 0.499):
                key = {"case": "bending", "form": form, "poisson": poisson, "spacing": spacing}
                steps = [find(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
                cells.append(" / ".join(f"{1e6 * row['step']:.0f}" if row else "not run" for row in steps))
            lines.append([f"{form} form, {millimetres(spacing)}", *cells])
    return markdown(["", "ν = 0.49: lattice / jittered", "ν = 0.499: lattice / jittered"], lines)


@block("incompressible", command="python validation/incompressible.py volumetric")
def incompressible_volumetric(found: Row) -> str:
    """Return the errors of the forms of U(J)."""
    lines = []
    for case in ("tension", "compression"):
        for volumetric in ("quadratic", "logarithmic", "mixed"):
            pair = [find(found["volumetric"], case=case, volumetric=volumetric, form=f) for f in ("energy", "strong")]
            elements = f"{pair[0]['elements']:.4f}".replace("-", "−")
            lines.append([f"{case}, {volumetric}", elements, *(signed(row["error"], 2) for row in pair)])
    return markdown(["", "elements [N]", "energy form", "strong form"], lines)


# Laws


@block("law_elements", command="python validation/law_elements.py")
def law_elements(found: Row) -> str:
    """Return the errors of the force on a block against finite elements, for every law, over the spacing."""
    rows = found["rows"]
    spacings = distinct(round(row["spacing"], 9) for row in rows)
    lines = []
    for law in dict.fromkeys(row["law"] for row in rows):
        for form in ("energy", "strong"):
            own = [row for row in rows if row["law"] == law and row["form"] == form]
            cells = []
            for case in found["about"]["cases"]:
                errors = {round(row["spacing"], 9): row["error"] for row in own if row["case"] == case}
                cells.append(", ".join(signed(errors[h], unit="") if h in errors else "–" for h in spacings))
            if own:
                lines.append([f"`{law}`", form, *cells])
    return markdown(["law", "form", *found["about"]["cases"]], lines)


@block("closed_forms", command="python validation/closed_forms.py")
def closed_forms(found: Row) -> str:
    """Return the errors of torsion and inflation against the laws' closed forms."""
    symbols = {"moment": "M [N m]", "force": "N [N]", "pressure": "p [Pa]"}
    lines = []
    for case, law in dict.fromkeys((row["case"], row["law"]) for row in found["rows"]):
        own = [row for row in found["rows"] if (row["case"], row["law"]) == (case, law)]
        own.sort(key=lambda row: -row["spacing"])
        for quantity, exact in own[0]["exact"].items():
            errors = ", ".join(signed(row[f"{quantity}_error"], 2, "") for row in own)
            numbers = [f"{value:.4g}".replace("-", "−") for value in (exact, own[0]["incompressible"][quantity])]
            lines.append([case, f"`{law}`", symbols[quantity], *numbers, errors])
    return markdown(["case", "law", "of", "equation", "incompressible", "errors [%]"], lines)


INTERFACES = {
    "uniform, small": "uniform",
    "small, second half 4 times softer": "small, 0.25 times as stiff",
    "small, second half 5 times stiffer": "small, 5 times as stiff",
    "the same, mean of the compliances on the interface, softer": "small, 0.25 times as stiff, mean compliance",
    "the same, stiffer": "small, 5 times as stiff, mean compliance",
    "uniform, large": "large, soft",
    "large, soft then stiff": "large, soft then stiff",
    "large, stiff then soft": "large, stiff then soft",
}


@block("interfaces", command="python validation/interfaces.py")
def interfaces(rows: list[Row]) -> str:
    """Return the errors of the stretch of a bar of two halves."""
    heads = [f"{1e3 * row['spacing']:.2f} mm, {'midway' if row['cells'] % 2 else 'on nodes'}" for row in rows]
    lines = []
    for words, name in INTERFACES.items():
        errors = [row["error"].get(name) for row in rows]
        lines.append(
            [words, *("–" if e is None else f"{round(100 * e, 2) + 0.0:.2f}".replace("-", "−") for e in errors)]
        )
    return markdown(["error of the stretch [%] at", *heads], lines)


@block(
    "land",
    command="python validation/land.py --cells 4 6 --bulk 100e3 --keep` and `... --cells 4 --bulk 400e3 800e3 --keep",
)
def land(found: Row) -> str:
    """Return the place of the tip in the cardiac benchmark, over the bulk modulus."""
    scale = 2e3  # C bt / 2 of Guccione's law [Pa]
    lines = [
        [f"{row['bulk'] / scale:.0f}", str(row["cells_across"]), f"{row['tip_mm'][2]:.3f}"] for row in found["rows"]
    ]
    return markdown(["bulk modulus, over C bt/2 = 2 kPa", "cells across", "z of the tip [mm]"], lines)


# Organs and campaigns


@block("organ_models", command="python validation/organ_models.py")
def organ_models(entries: list[Row]) -> str:
    """Return times and errors of the models of every surface, with default choices."""
    lines = []
    for each in entries:
        small, large = each["small"], each.get("large")
        lines.append([
            each["organ"], f"{small['nodes']:,}", f"{each['new'] + each['first_force']:.0f} s",
            f"{small['seconds'] / 60:.1f} min", _force_errors(small),
            f"{large['seconds'] / 60:.1f} min" if large else "", _force_errors(large) if large else "",
            f"{(large or small)['megabytes']:.1f} MB",
        ])  # fmt: skip
    heads = [
        "organ", "nodes", "first force", "small model", "force; 95 %; surface", "32 paths", "force; 95 %; surface",
        "file",
    ]  # fmt: skip
    return markdown(heads, lines)


def _force_errors(found: Row) -> str:
    return f"{found['force']:.1%}; {found['force_95']:.1%}; {found['surface_95']:.1%}"


@block("organ_models", command="python validation/organ_models.py --held-out")
def organ_models_little_force(entries: list[Row]) -> str:
    """Return the errors of paths with little force, and of the others."""
    lines = []
    for each in entries:
        paths = each.get("large", {}).get("held_out", [])
        if paths:
            most = max(path["largest"] for path in paths)
            light = [path["force_95"] for path in paths if path["largest"] < LITTLE_FORCE * most]
            others = [path["force_95"] for path in paths if path["largest"] >= LITTLE_FORCE * most]
            spans = [f"{min(errors):.0%} to {max(errors):.0%}" if errors else "" for errors in (light, others)]
            lines.append([each["organ"], f"{most:.2g} N", f"{len(light)} of {len(paths)}", *spans])
    heads = ["organ", "largest force", "paths below a tenth of it", "their force, 95 %", "of the others"]
    return markdown(heads, lines)


@block("organs", command="python validation/organs.py --nodes 3000 10000 30000")
def organs(found: Row) -> str:
    """Return what came of poked organs, a surface and Poisson's ratio a line."""
    cases = [case for case in found["cases"] if case["form"] == "energy"]
    sizes = distinct((case["wished_nodes"] for case in cases), reverse=False)
    lines = []
    for surface, poisson in distinct(((case["surface"], case["poisson"]) for case in cases), reverse=False):
        cells = [_poked(find(cases, surface=surface, poisson=poisson, wished_nodes=size)) for size in sizes]
        lines.append([surface, f"{poisson:g}", *cells])
    return markdown(["surface", "Poisson's ratio", *(f"{size:,} nodes" for size in sizes)], lines)


def _poked(case: Row | None) -> str:
    if case is None:
        return "not run"
    if "energy_at_release" not in case:
        return f"stopped: {case['why'].split(';')[0]}"
    left = case["energy_at_end"] / case["energy_at_release"]
    outcome = f"{left:.0%} left" if case["stable"] else "energy grows"
    return f"{1e3 * case['spacing']:.3g} mm: {outcome}, gap {case['balance']:.2%}"


@block("out_of_core", command="python validation/out_of_core.py")
def out_of_core(rows: list[Row]) -> str:
    """Return memory and accuracy of the modes of snapshots in files."""
    of = {"strain": "du/dX", "displacement": "u"}
    lines = [
        [
            f"{row['modes']} of {of[row['method']]}", f"{row['nodes']:,}", f"{row['snapshots']:,}",
            f"{row['gigabytes']:.2f} GB, {row['gigabytes_before']:.2f} GB", f"{row['bytes_of_files'] / 1e9:.1f} GB",
            f"{row['seconds']:.0f} s", f"{row['missed']:.7e}", f"{row['best']:.7e}",
            f"{row['singular_values_off']:.0e}" if "singular_values_off" in row else "–",
        ]
        for row in rows
    ]  # fmt: skip
    heads = [
        "modes", "nodes", "snapshots", "peak memory, of it the model", "files", "time", "error of the modes",
        "of the best", "largest error of a singular value",
    ]  # fmt: skip
    return markdown(heads, lines)


# Peers


@block("peers", command="python benchmarks/peers.py")
def peers(found: Row) -> str:
    """Return errors and computing times of palpate and its peers."""
    rows = [
        [
            row["case"], row["program"], f"{row['nodes']:,}",
            f"{1e6 * row['step']:.0f} µs" if "step" in row else "none",
            f"{row['seconds_per_second']:.3g} s/s" if "step" in row else f"{row['solve_seconds']:.3g} s, statics",
            signed(row["error"], 2),
        ]
        for row in found["rows"]
    ]  # fmt: skip
    return markdown(["case", "program", "nodes", "step", "computing time", "error"], rows)


@block("peers", command="python benchmarks/peers.py")
def peers_references(found: Row) -> str:
    """Return the references of the comparison: the limit of each law, and how far the finest mesh is away."""
    rows = []
    for case, unit, scale in (("beam", "mm", -1e3), ("block", "N", 1.0)):
        reference = found["references"][case]
        away = abs(reference["meshes"][-1] / reference["laws"]["neo_hookean"] - 1)
        rows += [
            [case, law.replace("_", " "), f"{scale * value:.4g} {unit}", percent(away)]
            for law, value in reference["laws"].items()
        ]
    return markdown(["case", "law", "limit of three meshes", "finest mesh (palpate's law), away by"], rows)
