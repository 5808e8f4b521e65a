"""The first hour of a researcher in a notebook: a body is made, pressed, drawn, shown, saved and fitted."""

from __future__ import annotations

import base64
import re
from xml.etree import ElementTree

import pytest

pytestmark = pytest.mark.slow

MAX_TEXT_CHARACTERS = 400  # of the text of a result
PNG_HEAD = b"\x89PNG"
CELLS = {
    "import": "%matplotlib inline\nimport numpy as np\nimport palpate as pt",
    "body": """
cloud = pt.box((0.06, 0.02, 0.02), spacing=0.005)
tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
bar = pt.Solid(cloud, tissue, fixed="x-")
bar""",
    "equilibrium": 'rest = pt.equilibrium(bar, pt.SurfaceForce("x+", force=(0, 0, -0.3)))\nrest',
    "stress": 'rest.plot("stress");',
    "run": """
press = pt.tools.Contact(pt.tools.Sphere(0.008), lambda t: (0.05, 0.01, 0.0285 - 0.1 * t))
run = pt.rollout(bar, press, duration=0.05, every=0.005, progress=False)
run""",
    "force": 'run.plot("force");',
    "pressure": 'bar.plot("pressure", displacements=run.displacements[-1]);',
    "show": "page = bar.show()\npage",
    "files": """
pt.save(run, "run.h5")
run.save("run.vtkhdf")
rest.save("rest.vtkhdf")
rom = pt.hyper_reduce(bar, pt.rollout(bar, pt.Gravity(), duration=0.05, every=0.001, progress=False), modes=4)
rom.save("bar.rom")
pt.load("bar.rom").count, pt.Trajectory.load("run.h5").complete""",
    "mesh": 'mesh = rest.to_pyvista().warp_by_vector("displacement")\nmesh.n_points, sorted(mesh.point_data)',
    "fit": """
stretch = np.linspace(1, 1.6, 12)
curve = pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=8e3 * (stretch - stretch**-2))
fit = pt.materials.fit("Yeoh", curve)
fit""",
    "fit drawn": "fit.plot();",
    "fault": 'pt.SurfaceForce("z+", force=5)',
    "call": "pt.rollout(bar, press, duration=0.05, every=0.005, dt=1e-5)",
    "close": "page.close()\npage",
}
FAULTS = ("fault", "call")


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    """Execute the notebook; return the outputs of each cell by name."""
    import nbclient
    import nbformat

    cells = [nbformat.v4.new_code_cell(source.strip()) for source in CELLS.values()]
    for name, cell in zip(CELLS, cells, strict=True):
        cell.metadata["tags"] = ["raises-exception"] if name in FAULTS else []
    folder = tmp_path_factory.mktemp("notebook")
    notebook = nbformat.v4.new_notebook(cells=cells)
    resources = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    for name, cell in zip(CELLS, notebook.cells, strict=True):
        for output in cell.outputs:
            if "image/png" in output.get("data", {}):
                (folder / f"{name}.png").write_bytes(base64.b64decode(output["data"]["image/png"]))
    return {name: cell.outputs for name, cell in zip(CELLS, notebook.cells, strict=True)}


def data_of(outputs, name):
    """Return the data of the one result of a cell, which prints nothing else."""
    assert [output["output_type"] for output in outputs[name]] in (["execute_result"], ["display_data"]), outputs[name]
    return outputs[name][0]["data"]


@pytest.mark.parametrize("name", ["body", "equilibrium", "run", "fit"])
def test_results_are_tables_and_one_short_line(outputs, name):
    data = data_of(outputs, name)
    assert len(data["text/plain"]) < MAX_TEXT_CHARACTERS
    rows = list(ElementTree.fromstring(data["text/html"]).iter("tr"))
    assert len(rows) >= 5


@pytest.mark.parametrize("name", ["stress", "force", "pressure", "fit drawn"])
def test_figures_are_drawn_below_their_cells(outputs, name):
    content = base64.b64decode(data_of(outputs, name)["image/png"])
    assert content.startswith(PNG_HEAD)
    assert len(content) > 10_000


def test_the_live_page_is_in_a_cell_until_it_is_closed(outputs):
    frame = ElementTree.fromstring(data_of(outputs, "show")["text/html"]).find("iframe")
    assert re.fullmatch(r"http://localhost:\d+/#[\w-]{32}", frame.attrib["src"])
    assert "closed" in data_of(outputs, "close")["text/plain"]


def test_what_was_saved_is_read_again_and_pyvista_has_the_fields(outputs):
    assert data_of(outputs, "files")["text/plain"] == "(4, True)"
    assert data_of(outputs, "mesh")["text/plain"] == "(325, ['displacement', 'pressure', 'stress'])"


@pytest.mark.parametrize("name", FAULTS)
def test_a_traceback_ends_in_the_line_of_the_user(outputs, name):
    (error,) = outputs[name]
    lines = re.sub(r"\x1b\[[\d;]*m", "", "\n".join(error["traceback"])).splitlines()
    assert error["ename"] == "InputError"
    assert len(lines) <= 16
    assert any(line.startswith("----> 1") and CELLS[name] in line for line in lines)
    assert sum(line.startswith("File ") for line in lines) <= 1  # IPython shows the last frame also where it is hidden
