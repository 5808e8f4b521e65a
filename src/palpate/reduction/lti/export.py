"""Files of a linearised body for MATLAB and in the Matrix Market format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse

from palpate.core.files import whole_file
from palpate.reduction.lti.system import LinearSystem


def matrices(system: LinearSystem) -> dict[str, Any]:
    """Return the matrices by name: M, D, K, B, Cp, Cv, Df, S, Sv sparse or dense, as in `LinearSystem`."""
    return {
        "M": system.mass, "D": system.damping, "K": system.stiffness, "B": system.input, "Cp": system.output,
        "Cv": system.rate_output, "Df": system.feedthrough, "S": system.static, "Sv": system.static_rate,
    }  # fmt: skip


def save_matlab(system: LinearSystem, path: str | Path) -> None:
    """Write a MATLAB file (version 5), whole or not at all.

    It contains the matrices, and ``node`` and ``component`` of the unknowns, counted from 1 as in
    MATLAB. ``points`` (n, 3) [m], and the names ``inputs`` and ``outputs`` as cells, follow.

    Parameters
    ----------
    system : LinearSystem
    path : path

    Raises
    ------
    OSError
        The place cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> path = Path(tempfile.mkdtemp()) / "bar.mat"
    >>> pt.lti.save_matlab(system, path)
    >>> path.stat().st_size > 0
    True
    """
    from scipy.io import savemat

    path = Path(path)
    content = {name: sparse.csc_matrix(matrix) if sparse.issparse(matrix) else matrix
               for name, matrix in matrices(system).items()}  # fmt: skip
    content |= {
        "node": (system.dofs // 3 + 1).astype(float)[:, None],
        "component": (system.dofs % 3 + 1).astype(float)[:, None],
        "directions": system.directions,
        "points": system.model.cloud.points,
        "inputs": np.array(system.inputs, dtype=object)[:, None],
        "outputs": np.array(system.outputs, dtype=object)[:, None],
    }
    with whole_file(path) as partial:
        savemat(partial, content, appendmat=False, do_compression=True, oned_as="column")


def save_matrix_market(system: LinearSystem, folder: str | Path) -> None:
    """Write ``M.mtx``, ``D.mtx``, ... and ``unknowns.txt`` (node and component, counted from 0), each whole or not.

    The comments of ``B.mtx`` and ``Cp.mtx`` name the inputs and outputs.

    Parameters
    ----------
    system : LinearSystem
    folder : path
        Created if it does not exist.

    Raises
    ------
    OSError
        The place cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> folder = Path(tempfile.mkdtemp()) / "bar"
    >>> pt.lti.save_matrix_market(system, folder)
    >>> sorted(path.name for path in folder.iterdir())
    ['B.mtx', 'Cp.mtx', 'Cv.mtx', 'D.mtx', 'Df.mtx', 'K.mtx', 'M.mtx', 'unknowns.txt']
    """
    from scipy.io import mmwrite

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    comments = {"B": "inputs: " + "; ".join(system.inputs), "Cp": "outputs: " + "; ".join(system.outputs)}
    for name, matrix in matrices(system).items():
        if 0 in matrix.shape:  # S and Sv of a body without tools
            continue
        stored = sparse.coo_matrix(matrix) if sparse.issparse(matrix) else matrix
        with whole_file(folder / f"{name}.mtx") as partial:
            mmwrite(partial, stored, comment=comments.get(name, ""), precision=17, symmetry="general")
    with whole_file(folder / "unknowns.txt") as partial:
        np.savetxt(partial, np.column_stack([system.dofs // 3, system.dofs % 3]), fmt="%d")
