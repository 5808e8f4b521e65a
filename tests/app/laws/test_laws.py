"""The command ``laws``: the list agrees with the laws themselves."""

from __future__ import annotations

import json
from contextlib import nullcontext

import pytest

import palpate as pt
from palpate.app.cli import main


def test_laws_are_listed_for_people_and_for_machines(capsys):
    assert main(["laws"]) == 0
    text = capsys.readouterr().out
    assert main(["laws", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    laws, fibres, relaxation = printed["laws"], printed["fibre_laws"], printed["relaxation"]
    assert len(laws) >= 11
    for law in (*laws, *fibres, relaxation):
        assert f"\n{law['name']}\n" in text
        assert law["energy"] in text
        assert {"name", "unit", "range"} == set(law["parameters"][0])
    for law in laws:
        getattr(pt.materials, law["name"])(**law["example"], density=1000.0, poisson=0.4)
    for law in fibres:
        getattr(pt.materials, law["name"])(**law["example"], directions=(1.0, 0.0, 0.0))
    parameters = {"C1": 5e3, "density": 1000.0, "poisson": 0.4}
    pt.materials.NeoHookean(**parameters, prony=pt.materials.Prony(**relaxation["example"]))
    for form in printed["volumetric"]:
        assert f"U = {form['energy']}" in text
        assert (
            pt.materials.NeoHookean(**parameters, volumetric=form["name"]) == pt.materials.NeoHookean(**parameters)
        ) == form["default"]


@pytest.mark.parametrize(
    ("kind", "name", "low_open"), [("shares", "", True), ("times", "s", True), ("bulk_shares", "", False)]
)
def test_the_listed_ranges_of_a_relaxation_are_those_it_keeps(capsys, kind, name, low_open):
    main(["laws", "--json"])
    relaxation = json.loads(capsys.readouterr().out)["relaxation"]
    entry = next(p for p in relaxation["parameters"] if p["name"] == kind)
    assert entry == {"name": kind, "unit": name, "range": f"{'(' if low_open else '['}0, inf)"}
    for value, allowed in ((-1e-9, False), (0.0, not low_open), (1e-9, True)):
        numbers = {"shares": 0.5, "times": 0.1, "bulk_shares": 0.2, kind: value}
        with nullcontext() if allowed else pytest.raises(pt.InputError, match=kind):
            pt.materials.Prony(**numbers)
