"""Force evaluations with every law, over one with the neo-Hookean law.

    python benchmarks/laws.py [--nodes 8000] [--jitter 0.2] [--laws Gent Ogden] [--json FILE]

All models of a form are measured in turn, round after round, so that what else the machine does meets all alike. The
neo-Hookean law stands twice: the ratio of the two is what the machine itself wavers.
"""

from __future__ import annotations

import argparse
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

TIMES = 5  # evaluations in a row
FORMS = ("strong", "energy", "membrane")


def materials(poisson: float) -> dict[str, Any]:
    """Make one material of every law."""
    import palpate as pt
    from palpate.tissue.catalogue import LAWS

    common = {"density": 1000.0, "poisson": poisson}
    made = {law.name: getattr(pt.materials, law.name)(**law.example, **common) for law in LAWS}
    own = {"C1": 5e3, "C2": 1e3, "C3": 200.0}
    text = "C1*(I1 - 3 - 2*log(J)) + C2*(I1 - 3 - 2*log(J))**2 + C3*(I1 - 3 - 2*log(J))**3"
    made["Hyperelastic, as Yeoh"] = pt.materials.Hyperelastic(text, **own, **common)
    if poisson == 0.5:
        del made["LinearElastic"]
    else:
        series = pt.materials.Prony(shares=(0.3, 0.2, 0.1), times=(0.01, 0.1, 1.0))
        made["Prony, three branches"] = pt.materials.NeoHookean(C1=5e3, prony=series, **common)
    return {**made, "NeoHookean again": pt.materials.NeoHookean(C1=5e3, **common)}


def fibres() -> dict[str, Any]:
    """Make laws of fibres, to lie in the neo-Hookean law; of the energy form."""
    import palpate as pt

    hgo, along = {"k1": 20e3, "k2": 2.0, "dispersion": 0.1}, (1.0, 0.0, 0.0)
    return {
        "Fibres, one family": pt.materials.Fibres(**hgo, directions=along),
        "Fibres, two families": pt.materials.Fibres(**hgo, directions=(along, (0.6, 0.8, 0.0))),
        "Guccione": pt.materials.Guccione(C=2e3, bf=8.0, bt=2.0, bfs=4.0, directions=along),
    }


def regions() -> dict[str, tuple[Any, Any]]:
    """Make pairs of materials of one law, for the two halves of a body; of the energy form."""
    import palpate as pt

    common = {"density": 1000.0, "poisson": 0.45}
    return {
        "NeoHookean, two regions": (
            pt.materials.NeoHookean(C1=5e3, **common),
            pt.materials.NeoHookean(C1=9e3, **common),
        ),
        "Gent, two regions": (
            pt.materials.Gent(mu=10e3, Jm=3.0, **common),
            pt.materials.Gent(mu=20e3, Jm=1.5, **common),
        ),
        "Ogden, two regions": (
            pt.materials.Ogden(C=(800.0, 120.0), alpha=(4.0, -7.5), **common),
            pt.materials.Ogden(C=(600.0, 300.0), alpha=(3.0, -5.0), **common),
        ),
    }


def model(form: str, material: Any, nodes: int, jitter: float, within: Any = None) -> Any:
    """Make a model of one form; of a pair of materials, by region."""
    import palpate as pt

    if form == "membrane":
        cloud = pt.disc(0.005 * (nodes / 3.14) ** 0.5, 0.005)
        return pt.Membrane(cloud, material, 1e-3, prestretch=1.1, stiffness_damping=1e-5)
    cloud = pt.box(((round(nodes ** (1 / 3)) - 1) * 0.005,) * 3, 0.005, jitter)
    if isinstance(material, tuple):
        near = cloud.points[:, 0] < cloud.points[:, 0].mean()
        material = [material[0] if is_near else material[1] for is_near in near]
    return pt.Solid(cloud, material, "x-", form=form, stiffness_damping=5e-5, fibres=within)


def measure(form: str, nodes: int, jitter: float, laws: list[str] | None, repeats: int) -> dict[str, float]:
    """Return the median time [ns] of a force evaluation, per node, for every law."""
    from timing import median_seconds

    chosen = materials(0.5 if form == "membrane" else 0.45)
    if laws:
        chosen = {name: law for name, law in chosen.items() if name.split()[0] in {"NeoHookean", *laws}}
    if form == "strong":
        chosen = {name: law for name, law in chosen.items() if law.prony is None}
    models = {name: model(form, law, nodes, jitter) for name, law in chosen.items()}
    if form == "energy":
        asked = {name: pair for name, pair in regions().items() if not laws or name.split(",")[0] in laws}
        models |= {name: model(form, pair, nodes, jitter) for name, pair in asked.items()}
        added = {name: law for name, law in fibres().items() if not laws or name.split()[0].strip(",") in laws}
        models |= {name: model(form, chosen["NeoHookean"], nodes, jitter, law) for name, law in added.items()}
    calls = []
    for each in models.values():
        u = 2e-4 * np.random.default_rng(0).standard_normal((len(each.cloud), 3))
        work = each.workspace().passes
        if each.material.prony is not None:
            work.history.interval[0] = 1e-5  # stores history at every evaluation, as in a run
        calls.append(partial(several, each, work, u, np.zeros_like(u)))
    seconds = median_seconds(*calls, repeats=repeats)
    return {name: 1e9 * t / TIMES / len(m.cloud) for (name, m), t in zip(models.items(), seconds, strict=True)}


def several(model: Any, work: Any, u: Any, out: Any) -> None:
    """Evaluate the force a few times, so that the model's own arrays are where a run finds them."""
    for _ in range(TIMES):
        model._internal_force(u, model.body, work, out)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, default=8_000)
    parser.add_argument("--jitter", type=float, default=0.2)
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=FORMS)
    parser.add_argument("--laws", nargs="+")
    parser.add_argument("--repeats", type=int, default=31)
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args()
    report = {}
    for form in args.forms:
        report[form] = found = measure(form, args.nodes, args.jitter, args.laws, args.repeats)
        print(f"{form}, {args.nodes} nodes, jitter {args.jitter:g}")
        for name, time in found.items():
            print(f"  {name:20s} {time:8.1f} ns a node  {time / found['NeoHookean']:5.2f}", flush=True)
    if args.json:
        args.json.write_text(json.dumps({"nodes": args.nodes, "jitter": args.jitter, "ns_per_node": report}, indent=2))


if __name__ == "__main__":
    main()
