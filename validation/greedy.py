"""Errors of models trained on chosen and on random paths, by number of training runs.

    python validation/greedy.py [--most 32] [--held-out 24] [--modes 24] [--scene beam] [--set NAME=X ...] [--out DIR]
    python validation/greedy.py --scene liver --set spacing=0.012 radius=0.026 --held-out 28 --modes 32

A campaign with a tolerance that no model keeps chooses its paths round by round. At the same numbers of runs, models
are trained on the first random paths. Both are judged on the same held-out runs. Where tools touch the body, errors are
those of forces (median while pressed) and of the surface (95th percentile). Results of a scene are added to
docs/validation/greedy.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import result_files

from palpate.app.common.console import Console
from palpate.app.train.campaign import Campaign
from palpate.app.train.choose import FIRST_RUNS
from palpate.app.train.folder import manifest_of, open_campaign
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.training import open_training

NAMES = ("displacement", "velocity", "reaction")
CONTACT_NAMES = ("force", "force_95", "surface_95")


def errors(model: ReducedModel) -> dict[str, float]:
    """Return mean errors over the held-out runs, and the largest of the first of them."""
    held_out = model.report["held_out"]
    touched, names = held_out.get("contact"), CONTACT_NAMES if "contact" in held_out else NAMES
    means = (touched or held_out)["mean"]
    return {name: means[name] for name in names} | {
        "largest": max(run[names[0]] for run in held_out["runs"] if names[0] in run)
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="beam")
    parser.add_argument("--set", nargs="*", default=[], dest="given", metavar="NAME=X")
    parser.add_argument("--most", type=int, default=32)
    parser.add_argument("--held-out", type=int, default=24)
    parser.add_argument("--modes", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="folder of the campaign; by default a temporary one")
    args = parser.parse_args()
    scene = open_training(args.scene, dict(pair.split("=", 1) for pair in args.given))
    with TemporaryDirectory() as temporary:
        folder = args.out or Path(temporary)
        with open_campaign(folder, manifest_of(args.scene, scene, args.seed)) as own:
            campaign = Campaign(own, scene, Console(), args.modes, workers=args.workers)
            chosen, rounds = list(range(FIRST_RUNS)), {}
            while True:
                model = campaign.train(campaign.jobs(chosen, args.held_out))
                rounds[len(chosen)] = errors(model)
                if len(chosen) >= args.most:
                    break
                chosen += campaign.further_paths(model, chosen, args.most)
            random = {count: errors(campaign.train(campaign.jobs(range(count), args.held_out))) for count in rounds}
    print(f"{scene.title}, {len(scene.model.cloud)} nodes, {args.modes} modes; chosen / random paths")
    names = list(rounds[max(rounds)])
    print(f"{'runs':>4} " + " ".join(f"{name:>17}" for name in names))
    for count, own in rounds.items():
        cells = [f"{own[name]:8.2%}/{random[count][name]:8.2%}" for name in names]
        print(f"{count:4} " + " ".join(cells))
    results = result_files.read("greedy", {})
    found = [{"runs": count, "chosen": own, "random": random[count]} for count, own in rounds.items()]
    result_files.write("greedy", results | {args.scene: {"nodes": len(scene.model.cloud), "rows": found}})


if __name__ == "__main__":
    main()
