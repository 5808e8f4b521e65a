"""Parser of ``palpate fit``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import add_command, add_output, existing_file, number, whole


def add_fit(commands: Any) -> None:
    """Add the command to those of a parser."""
    fit = add_command(
        commands,
        "fit",
        "palpate.app.fit.command:fit_law",
        summary="find a law's parameters from measured curves",
        description="Fit a law to curves of nominal stress from CSV files with units. Leave a report with standard "
        "errors and the law's stability, and a picture, in a folder. See docs/howto/fitting.md for the files.",
    )
    fit.synonyms |= {"data": "DATA.csv"}
    add = fit.add_argument
    add("law", metavar="LAW", help="name of a law, such as NeoHookean or mooney-rivlin; palpate laws lists them")
    add("data", type=existing_file, nargs="+", metavar="DATA.csv", help="files of curves, fitted together")
    several: dict[str, Any] = {"action": "extend", "nargs": "+", "default": []}
    text = "values to start from; they also set the number of terms of a law that has several"
    add("--start", **several, metavar="NAME=X[,X]", help=text)
    add("--bounds", **several, metavar="NAME=LOW,HIGH", help="ranges of parameters")
    add("--fix", **several, dest="fixed", metavar="NAME=X[,X]", help="parameters that keep their value")
    add("--starts", type=whole, default=8, metavar="K", help="number of starts")
    add("--seed", type=whole, default=0, metavar="K", help="seed of the other starts")
    text = "Poisson's ratio: 0.5 for curves at constant volume, or at most 0.499"
    add("--poisson", type=number, default=0.5, metavar="NU", help=text)
    add("--density", type=number, default=1060.0, metavar="RHO", help="density of the tissue [kg/m^3]")
    add_output(fit, "out/fit")
