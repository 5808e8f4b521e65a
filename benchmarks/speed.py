"""Speed of full and reduced models: one table, all ratios from one run.

    python benchmarks/speed.py [--fine] [--repeats 3] [--out out/speed]

Full and reduced models take turns; all figures are medians. The report is in the folder. ``--fine`` measures the beam
at 2.5 mm, too, one round against the energy form, which takes about ten minutes. Run nothing else meanwhile.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from pressed_liver import full_case
from speed_cases import beam_case, large_case

from palpate.app.common.console import Console, quantities_table
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.core.faults import DivergenceError
from palpate.core.files import check_folder, plain

# spacings [m], rounds (0: as many as asked for) and forms of the full model
COARSE_BEAM, FINE_BEAM = (0.005, 0, ("strong", "energy")), (0.0025, 1, ("energy",))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fine", action="store_true", help="measure the beam at 2.5 mm, too")
    parser.add_argument("--repeats", type=int, choices=range(1, 1001), default=3, metavar="K", help="rounds")
    parser.add_argument("--out", type=Path, default=Path("out/speed"), metavar="DIR", help="folder of the report")
    args = parser.parse_args()
    check_folder(args.out)
    report = measure(args.fine, args.repeats, Console())
    threads = report["machine"]["threads"]
    title = f"Speed: medians of {args.repeats} rounds; full models on {threads} threads, reduced ones on one"
    table = quantities_table(title, ["here"], {name: [value] for name, value in _rows(report).items()})
    args.out.mkdir(parents=True, exist_ok=True)
    deliver(report, [table], args.out, REPORTS, as_json=False)


def measure(fine: bool, repeats: int, console: Console) -> dict[str, Any]:
    """Return the report, without the beam at a spacing whose run diverged."""
    report: dict[str, Any] = {
        "title": "Speed",
        "machine": machine(),
        "repeats": repeats,
        "large": large_case(repeats, console),
        "full_body": full_case(repeats, console),
        "beam": [],
    }
    for spacing, rounds, forms in (COARSE_BEAM, FINE_BEAM) if fine else (COARSE_BEAM,):
        try:
            report["beam"].append(beam_case(spacing, rounds or repeats, forms, console))
        except DivergenceError as error:  # earlier results are kept
            console.say(f"beam, {1e3 * spacing:g} mm: failed: {' '.join(str(error).split())}")
    return plain(report)


def _rows(report: dict[str, Any]) -> dict[str, str]:
    rows: dict[str, str] = {}
    for case in report["beam"]:
        rows |= _beam_rows(case)
    return rows | _large_rows(report["large"]) | _full_rows(report["full_body"])


def _beam_rows(case: dict[str, Any]) -> dict[str, str]:
    name, fast = f"beam, {1e3 * case['spacing']:g} mm, {case['nodes']:,} nodes", case["hyper_reduced"]
    rows = {
        f"{name}: full model, {form} form": (
            f"{full['steps_per_second']:,.0f} steps/s, {full['real_time_factor']:.3g} of real time"
        )
        for form, full in case["full"].items()
    }
    ratios = "; ".join(f"{100 * ratio:.2g} % ({form} form)" for form, ratio in fast["ratio"].items())
    return rows | {
        f"{name}: a step of {fast['modes']} modes at {fast['nodes']} sampled nodes": (
            f"{1e6 * fast['compiled_seconds_per_step']:.3g} us; {1e6 * fast['seconds_per_step']:.3g} us in `rollout`"
        ),
        f"{name}: the same, speed": f"{fast['real_time_factor']:.3g} times real time",
        f"{name}: time for the paper's pull of 1 s over the full model's": ratios,
    }


def _full_rows(full: dict[str, Any]) -> dict[str, str]:
    name, rows = f"full liver of {full['nodes']:,} nodes under a ball", dict[str, str]()
    for case in full["threads"]:
        on = f"{case['threads']} thread{'s' if case['threads'] > 1 else ''}"
        rows[f"{name}: a period of 1 ms on {on}: mean, median, 99 %"] = ", ".join(
            f"{1e3 * case[key]:.3g}" for key in ("mean_seconds", "median_seconds", "seconds_99")
        ) + " ms"  # fmt: skip
        rows[f"full body: nodes in real time on {on}"] = f"{case['nodes_in_real_time']:,.0f}"
    return rows


def _large_rows(large: dict[str, Any]) -> dict[str, str]:
    name = f"{large['modes']} modes at {large['nodes']} sampled nodes"
    size, speed = large["table_bytes"] / 1e3, large["read_bytes_per_second"] / 1e9
    small, big = (body["nodes"] for body in large["bodies"])
    compiled, rolled = (
        [1e6 * body[key] for body in large["bodies"]] for key in ("compiled_seconds_per_step", "seconds_per_step")
    )
    return {
        f"{name}: a force evaluation": f"{1e6 * large['force_seconds']:.3g} us",
        f"{name}: the same over reading its operator table ({size:.0f} kB at {speed:.3g} GB/s)": (
            f"{large['force_over_reading']:.2g}"
        ),
        f"{name}: the same over reading it from memory ({size / large['memory_read_seconds'] / 1e6:.3g} GB/s)": (
            f"{large['force_over_memory_reading']:.2g}"
        ),
        f"{name}: a step, trained on {big:,} nodes over {small:,}": (
            f"{large['compiled_step_ratio']:.3g} ({compiled[1]:.3g} / {compiled[0]:.3g} us)"
        ),
        f"{name}: the same in `rollout`": f"{large['step_ratio']:.3g} ({rolled[1]:.3g} / {rolled[0]:.3g} us)",
    }


if __name__ == "__main__":
    main()
