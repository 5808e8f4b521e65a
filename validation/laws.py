"""The curves of docs/reference/laws.md: a panel for every law of tissue, of fibres, of relaxation and of volume.

    python validation/laws.py [--out docs/images/laws.png]

Nominal stress in uniaxial tension and compression, in equal tension in two directions and in simple shear, the volume
kept, with the parameters of the examples in `palpate laws`. Stresses are over the shear modulus at rest, so that all
laws leave rest with one slope and differ by how they go on. Dots are SymPy's derivatives of the printed energies
(printed_laws.py). Fibres are in tissue that is stretched along and across them and sheared along them.
"""

from __future__ import annotations

import argparse
import re
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
from printed_laws import fibre_energy, printed
from scipy.optimize import minimize_scalar

import palpate as pt
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS, RELAXATION
from palpate.tissue.homogeneous import compressible, isochoric_stress
from palpate.tissue.volumetric import FORM_BY_NAME

STRETCH, TWO, SHEAR = np.linspace(-0.45, 0.9, 109), np.linspace(-0.25, 0.5, 76), np.linspace(-0.45, 0.9, 109)
PATHS = {"uniaxial": (STRETCH, "tab:blue"), "equibiaxial": (TWO, "tab:green"), "shear": (SHEAR, "tab:orange")}
GIVEN = {"density": 1000.0, "poisson": 0.5}
COLUMNS = 4  # of panels
TEXT = "C1*(I1bar - 3) + C2*(exp(b*(I1bar - 3)) - 1)"


def curve(material: pt.materials.Material, kind: str, amount: np.ndarray) -> np.ndarray:
    """Nominal stress over the shear modulus by palpate; `amount` is the shear, or the stretch less 1."""
    if isinstance(material, pt.materials.LinearElastic):  # keeps the volume of small strains only
        return {"uniaxial": 3.0, "equibiaxial": 6.0, "shear": 1.0}[kind] * amount
    return isochoric_stress(material, kind, amount + (kind != "shear")) / material.shear_modulus


def dots(material: pt.materials.Material, kind: str, amount: np.ndarray) -> np.ndarray:
    """The same by the printed energy."""
    law = printed(compressible(material))
    F, s = np.zeros((len(amount), 3, 3)) + np.eye(3), amount + 1
    if kind == "shear":
        F[:, 0, 1] = amount
        return law.stress(F)[:, 0, 1] / material.shear_modulus
    sides = (s**-0.5, s**-0.5) if kind == "uniaxial" else (s, s**-2)
    F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = s, *sides
    P = law.stress(F)
    return (P[:, 0, 0] - P[:, 2, 2] * sides[1] / s) / material.shear_modulus


def source(reference: str) -> str:
    """Authors and year of a reference."""
    authors = list(takewhile(lambda part: " " not in part, reference.split(";")[0].split(", ")))
    year = re.search(r"\b(1[89]|20)\d\d\b", reference)
    names = " and ".join(authors) if len(authors) < 3 else f"{authors[0]} et al."
    return f"{names} {year[0] if year else ''}".strip()


def law_panel(axis: Any, material: pt.materials.Material, title: str, below: str) -> None:
    for kind, (amount, colour) in PATHS.items():
        axis.plot(amount, curve(material, kind, amount), color=colour, label=kind)
        if not isinstance(material, pt.materials.LinearElastic):
            few = amount[::12]
            axis.plot(few, dots(material, kind, few), ".", color=colour, markersize=5)
    axis.set(ylim=(-6, 6), xlim=(-0.5, 0.95))
    heading(axis, title, below)


def fibre_panel(
    axis: Any, tissue: pt.materials.Material | None, fibres: pt.materials.FibreLaw, title: str, below: str
) -> None:
    """Nominal stress [kPa] along and across fibres, from the energy at the stretches that make it least."""

    def energy(F: np.ndarray) -> float:
        found = fibres.at(np.zeros((1, 3))).energy(F[None])[0]
        again = fibre_energy(fibres, F)
        assert np.isclose(found, again, rtol=1e-12, atol=1e-9)
        return found + (0.0 if tissue is None else float(tissue.shear_energy(F)))

    def across(stretch: float) -> float:
        def other(free: float) -> float:
            return energy(np.diag([np.exp(free), stretch, np.exp(-free) / stretch]))

        return minimize_scalar(other, bounds=(-0.5, 0.5), method="bounded", options={"xatol": 1e-10}).fun

    amount = np.linspace(-0.25, 0.3, 56)
    curves = {
        "uniaxial": [energy(np.diag([1 + a, (1 + a) ** -0.5, (1 + a) ** -0.5])) for a in amount],
        "across": [across(1 + a) for a in amount],
        "shear": [energy(np.eye(3) + a * np.diag([1.0, 0.0], k=1)) for a in amount],
    }
    for kind, values in curves.items():
        colour = PATHS[kind][1] if kind in PATHS else "tab:purple"
        stress = np.gradient(values, amount, edge_order=2) / 1e3
        label = {"uniaxial": "along", "across": "across"}.get(kind, kind)
        axis.plot(amount, stress, color=colour, label=label)
    axis.set(ylim=(-20, 40), ylabel="stress [kPa]")
    axis.legend(frameon=False, loc="upper left", handlelength=1.2)
    heading(axis, title, below)


def relaxation_panel(axis: Any) -> None:
    prony = pt.materials.Prony(**RELAXATION.example)
    times = np.geomspace(1e-3, 3, 200)
    axis.semilogx(times, prony.relaxation(times), color="tab:blue", label="modulus at time t")
    turned = prony.complex_modulus(1 / times)
    axis.semilogx(times, turned.imag, color="tab:orange", label="loss at 1/t")
    axis.set(ylim=(0, 2.4), xlabel="t [s]", ylabel="over modulus in equilibrium")
    axis.legend(frameon=False, loc="upper right", handlelength=1.2)
    heading(axis, "Prony", source(RELAXATION.reference))


def volume_panel(axis: Any) -> None:
    J = np.linspace(0.2, 2.0, 181)
    for form in FORM_BY_NAME.values():
        axis.plot(J, form.pressure(J - 1)[0], label=form.name)
    axis.set(ylim=(-4, 1.5), xlabel="J", ylabel="U'(J) / lame")
    axis.legend(frameon=False, loc="lower right", handlelength=1.2)
    heading(axis, "volumetric", "the three forms of U(J)")


def heading(axis: Any, title: str, below: str) -> None:
    axis.set_title(title, fontweight="bold", loc="left", pad=18)
    axis.text(0, 1.03, below, transform=axis.transAxes, fontsize=9, in_layout=False)
    axis.grid(alpha=0.3)
    axis.axhline(0, color="0.6", linewidth=0.8)


def main() -> None:
    """Draw."""
    import matplotlib.pyplot as plt

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/images/laws.png"))
    out = parser.parse_args().out
    plt.rcParams.update({"font.size": 10, "axes.titlesize": 11, "legend.fontsize": 9})
    rows = -(-(len(LAWS) + 1 + len(FIBRE_LAWS) + 2) // COLUMNS)  # a written law, relaxation and volume in addition
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(11, 2.95 * rows), layout="constrained")
    panels = iter(axes.ravel())
    for law in LAWS:
        law_panel(next(panels), law.kind(**law.example, **GIVEN), law.name, source(law.reference))
    own = pt.materials.Hyperelastic(TEXT, C1=4e3, C2=1e3, b=2.0, **GIVEN)
    law_panel(next(panels), own, "Hyperelastic", "an energy of one's own")
    for law in FIBRE_LAWS:
        tissue = (
            None if law.kind is pt.materials.Guccione else pt.materials.NeoHookean(C1=5e3, **GIVEN)
        )  # Guccione's is the whole energy
        fibres = law.kind(**law.example, directions=(1.0, 0.0, 0.0))
        fibre_panel(next(panels), tissue, fibres, law.name, source(law.reference))
    relaxation_panel(next(panels))
    volume_panel(next(panels))
    for axis in panels:
        axis.set_visible(False)
    last = (len(LAWS) + 1) // COLUMNS  # rows that hold laws of tissue alone
    for axis in axes[:last, 0]:
        axis.set_ylabel("stress / shear modulus")
    for axis in axes[last - 1]:
        axis.set_xlabel("stretch - 1, or shear")
    handles, _ = axes[0, 0].get_legend_handles_labels()
    names = ["uniaxial", "equibiaxial", "simple shear; dots: the printed energy"]
    figure.legend(handles, names, loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(out, dpi=100)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
