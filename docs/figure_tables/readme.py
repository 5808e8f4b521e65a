"""The four figures of the README, the speed of models, and the paper's claims next to ours."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, find, markdown, microseconds, percent, significant
from figure_tables.cuts import CRACKS
from figure_tables.examples import BEAM_RUNS, MEMBRANE_RUN, error_cells, membrane_phase, projected, series_of

PATCHES = "python validation/patches.py --keep"


def displacements(rows: dict[int, Row], *sizes: int) -> str:
    """Return the displacement errors of models of some numbers of modes."""
    return "; ".join(percent(rows[modes]["errors"]["displacement"]) for modes in sizes)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45", timed=True)
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


@block("reproduce_membrane", command=MEMBRANE_RUN, timed=True)
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
    """Return what `python benchmarks/speed.py` measured of reduced models."""
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


@block("bench", command="python benchmarks/speed.py", timed=True)
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
    "elements", "patches", "cuts", "reproduce_beam",
    command=f"python validation/elements.py`, `{PATCHES}`, `{CRACKS}` and `{BEAM_RUNS}",
    timed=True,
)  # fmt: skip
def readme_figures(elements: list[Row], patches: list[Row], found: Row, beam: Row) -> str:
    """Return the four figures of the README, each with what it is compared with and the command that makes it."""
    fine = [row for row in elements if row["scale"] == 1.0 and "frequencies" in row]
    bodies = {row["case"].split()[0] for row in fine}
    worst = [percent(max(abs(each) for row in fine for each in row[name])) for name in ("frequencies", "sag", "patch")]
    deep = max(abs(row["errors"][-1]) for row in patches if row["fits"] == "curved")
    pennies = [row for row in found["penny"] if row["radius"] == max(row["radius"] for row in found["penny"])]
    crack = [percent(max(abs(row[name]) for row in pennies)) for name in ("center", "release")]
    six, eight = projected(beam)[6], find(beam["reduced"], series="hyper-reduced", modes=8)
    rows = [
        [
            f"{len(bodies)} bodies of 3,000 nodes, ν 0.3 to 0.49: frequencies; sag; force on a disc of three spacings",
            "quadratic finite elements", "; ".join(worst), "`python validation/elements.py`",
        ],
        [
            "force of a tool of 1 to 2 spacings in radius, one radius deep, on a layer and on balls, mean",
            "closed forms (Johnson; Lur'e)", percent(deep), f"`{PATCHES}`",
        ],
        [
            f"a round cut of {pennies[0]['radius']} spacings in radius: opening; energy release",
            "closed form (Sneddon)", "; ".join(crack), f"`{CRACKS}`",
        ],
        [
            "the paper's beam: displacement with 6 modes; time of a sampled model of 8 modes over the full model's",
            "the paper: < 3 %; 3 %", f"{displacement(six)}; {percent(eight['ratio'])}", f"`{BEAM_RUNS}`",
        ],
    ]  # fmt: skip
    return markdown(["largest errors", "against", "here", "command"], rows)


def displacement(entry: Row) -> str:
    """Return the displacement error of a reduced run."""
    return percent(entry["errors"]["displacement"])
