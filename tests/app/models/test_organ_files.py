"""Every solid of the organ files at hand, opened with defaults and pressed by a ball in the engine's model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.app.common.console import Console
from palpate.app.models.full_body import prepare_full_body
from palpate.scenes.open_scene import open_scene
from palpate.scenes.places import CAMERA_SIDE

DATA = Path(__file__).parents[4] / "shared" / "data"
pytestmark = pytest.mark.slow
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the organ surfaces are not at hand")
SOLIDS = {  # volume [litres]
    "hra/VH_F_Liver.glb": 2.14, "hra/VH_M_Liver.glb": 1.64, "hra/VH_F_liver_solid_2k.ply": 1.99,
    "hra/VH_F_liver_solid_6k.ply": 1.99, "hra/VH_F_liver_solid_12k.ply": 1.99, "hra/VH_F_liver_solid_30k.ply": 1.99,
    "sofa/liver.obj": 0.0366, "sofa/liver-smooth.obj": 0.0393, "sofa/liver.vtk": 1.477,
}  # fmt: skip


def press(model):
    """Press the side of the camera by 2 spacings in 0.1 s; return the force (3,) over that of Hertz, last 20 ms."""
    points, spacing = model.cloud.points, model.cloud.spacing
    outward = np.array(CAMERA_SIDE)
    tip = points[np.argmax(points @ outward)]
    radius, depth = 3.0 * spacing, 2.0 * spacing
    home = tip + (radius + 0.2 * spacing) * outward
    made = pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(radius), tuple(home)))
    q, v, report, forces = np.zeros(len(made.rest)), np.zeros(len(made.rest)), np.zeros(20), []
    for k in range(120):
        target = np.zeros(12)
        target[:3] = -(depth + 0.2 * spacing) * min((k + 1) / 100, 1.0) * outward
        made.advance(made.data, q, v, target, 1e-3, report)
        assert report[0] == 0.0
        forces.append(report[8:11].copy())
    # the order of Hertz's force on an incompressible half-space: 16/3 G sqrt(R) d^1.5
    hertz = 16 / 3 * model.material.shear_modulus * np.sqrt(radius) * depth**1.5
    return np.mean(forces[-20:], axis=0) / hertz


@needs_data
def test_the_list_has_every_surface_file():
    found = {path.relative_to(DATA).as_posix() for path in DATA.rglob("*.*")}
    surfaces = {name for name in found if name.rpartition(".")[2] in ("glb", "obj", "ply", "vtk", "msh")}
    assert surfaces == {*SOLIDS, "sofa/liver.msh"}


def test_the_generated_liver_is_touched_with_defaults(tmp_path, monkeypatch):
    surface = pt.liver_surface()
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in 1e3 * surface.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in surface.triangles + 1]
    (tmp_path / "liver.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    check_touch(tmp_path / "liver.obj", 1.5, monkeypatch)


@needs_data
@pytest.mark.parametrize("name", SOLIDS)
def test_every_solid_is_touched_with_defaults(name, monkeypatch):
    check_touch(DATA / name, SOLIDS[name], monkeypatch)


def check_touch(path, litres, monkeypatch):
    monkeypatch.setattr("palpate.app.models.spacing._seconds_per_node", lambda material: 1.5e-6)  # of a slow machine
    model = prepare_full_body(open_scene(path), Console().status).body
    assert 1e3 * model.cloud.volumes.sum() == pytest.approx(litres, rel=0.01)
    force = press(model)
    assert np.isfinite(force).all()
    inwards = -force @ np.array(CAMERA_SIDE)
    assert 0.02 < inwards < 2.0
    assert np.linalg.norm(force) < 1.5 * inwards


@needs_data
def test_other_files_are_refused_with_what_they_are():
    with pytest.raises(pt.InputError, match=r"a hollow shell, watertight as it is: it encloses 0\.0744 litres"):
        _ = open_scene(DATA / "hra/VH_M_Liver.glb", part=("*capsule",)).surface
    with pytest.raises(pt.FileFormatError, match="is a Gmsh file of version 1 of a volume mesh; export its surface"):
        _ = open_scene(DATA / "sofa/liver.msh").surface
