"""Isosurfaces of fields on a grid, by marching cubes.

Every edge of the grid whose ends lie on different sides of the surface has one vertex, at the zero
of the linear interpolation. The signs at the eight corners of a cell select its triangles from a
table (W. E. Lorensen and H. E. Cline, Marching cubes, SIGGRAPH 1987). Vertices, triangles and
rounding are those of VTK's flying edges (W. Schroeder, R. Maynard and B. Geveci, LDAV 2015), so
that both give bitwise equal surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints

# Edges of a cell: axis, and offset of the lower end in x, y and z.
CUBE_EDGES = np.array(
    [
        [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0], [0, 0, 1, 1],
        [1, 0, 0, 0], [1, 0, 0, 1], [1, 1, 0, 0], [1, 1, 0, 1],
        [2, 0, 0, 0], [2, 0, 1, 0], [2, 1, 0, 0], [2, 1, 1, 0],
    ]
)  # fmt: skip
# Triangles of every case, three edges each, as digits of base 16; bit x + 2 y + 4 z of a case is corner (x, y, z).
TRIANGLE_TABLE = """
- 048 0a6 648a68 429 029809 60a294 62969aa98 6b2 0486b2 ab20a2 24828bb8a 46b94b 06b0b88b9 40a4a99ab
ab8b98 185 104514 0a6851 1a6165564 851429 951912210 a60851294 195a91a29a62 6b2851 4514106b2
ab2a20851 2ab25a24551a 46b4b9518 6b9691610519 185a90ab9940 1951a9ab9 a17 a17048 017607 817874476
a17294 02909817a 017076294 276287298178 6b2a17 4806b217a 7b2721120 27b472417481 b94b46a17
17a06886b8b9 7017907b9940 7817b8b98 a857a5 a04a47745 085056657 647457 57a5a8429 a57a25a02295
294086685657 962956576 a85a57b26 b26a07704745 820872857b27 27b247457 a87857b46b94 7057a05096b090b
90b940b07850705 97b579 593 480935 0a6935 8a6864935 542352 580503302 2352540a6 62363868a835 b26359
6b2480359 20a2ab359 35924bb48b8a b35b56654 b356b5658680 0540b50ab35b 5b358b8ab 318938 493430031
893831a60 a31a43a64934 842821123 021123 60a214231184 61a621231 31838926b 6b2490093031 1891930a22ab
b4ab24a41934143 84686383136b b06b30310 14318434b0a4b4a b1a31b 17a593 04817a935 760701593
935814417476 5425237a1 a17038023358 423435607701 382358286178687 a17b26593 3596b204817a 5937b11b2120
481417472b27935 a17b36635654 6b3635650805a17 1b017b0b435b4b5 5b358b7b11b8 37a3a99a8 49304303707a
089097076793 349374764 7a8782723428 a37a03023 687608783428382 637236 6b2a97a89937 04909303a7a36b2
978937870b27072 34937424bb47 6346b34387a383a b06b30a07703 0847b3 b37 b73 04873b a6073b 64868a73b
294b73 980902b73 0a629473b 73b62aa29a98 673263 673632480 a73a30032 78a728732482 394347746
098079067739 4390340730a7 3a739a98a 73b185 1041453b7 60a73b851 b7365a64551a 429518b73 73b125102295
0a618529473b a62a29a9151973b 326367185 672732410451 851a70073032 5a451a4a273a2a3 851479467739
796739690519091 0a7073034943851 3a739a1a55a9 ba13b1 13b1ba048 b60b03301 8648368133b6 ba1b13942
0282981ba13b 4290360133b6 3613b6168296869 6a1612213 4806a22a1213 012132 824812132 a13a34a46943
869806963a16361 439403013 381983 53b5b88ba 04505b0ba3b5 b5365b685608 b53b65645 294b83ba8853
25029505a3b5a5b 60868565b3b5294 962956b63365 6326836a8853 2a326a3a504a5a4 508530320 524325
83a853a36943634 06a953 508530409903 539 9b7597 9b7975804 75979b60a b75b59a68864 2b7274475
802827875b72 a6074b75442b a28a62825b72527 926965567 048652675592 a75a52a20259 52759272a482a28 674475
058065675 a40a74754 a5875a 71878bb89 71070979b904 0a68b189bb71 b19b71914a61416 2b7427471418
72b712102 42b4b74781870a6 72b71262aa21 267278289187 091049197269796 0720a7279187978 a71249 871847467
071670 871847a70074 a71 15919aa9b 04815aa59a9b 69b619601591 41648161b591b19 2ba2a52545a1
a5ba15b52805250 4b542b5b160b1b0 62b815 159a19a92a26 a15a59a96269048 915921201 915921814412 16a156546
16a156068865 140541 158 a8bb89 4a049a9ba 0b608b89b 4b69b4 2842b8ba8 a2b02a 2842b808668b 62b
6926a9a89 4a049a6a22a9 092890 492 684a86 06a 084 -
"""
TRIANGLE_CASES = TRIANGLE_TABLE.split()


def zero_surface(field: Floats, origin: Sequence[float] | Floats, step: float) -> tuple[Floats, Ints]:
    """Return the surface on which a field (nx, ny, nz) on a regular grid is zero, as vertices (v, 3) [m] and triangles.

    The field is negative on one side of the surface only. The first point is at `origin` (3,) [m], neighbouring points
    a step [m] apart. The surface is closed if it does not reach the boundary of the grid; normals point to the negative
    side.
    """
    above = field >= 0
    crossed = _crossed(above)
    k, j, axis, i = np.nonzero(crossed)
    lower = np.column_stack([i, j, k])
    first, second = (field[tuple(ends.T)] for ends in (lower, lower + np.eye(3, dtype=int)[axis]))
    places = lower.astype(float)
    places[np.arange(len(places)), axis] += -first / (second - first)
    vertices = (np.asarray(origin) + step * places.astype(np.float32).astype(float)).astype(np.float32).astype(float)
    return vertices, _triangles(above, np.cumsum(crossed).reshape(crossed.shape) - 1)


def _crossed(above: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which edges the surface crosses, (nz, ny, axis, nx), by their lower ends: the order of the vertices."""
    nx, ny, nz = above.shape
    crossed = np.zeros((nz, ny, 3, nx), dtype=bool)
    crossed[:, :, 0, :-1] = (above[:-1] != above[1:]).transpose(2, 1, 0)
    crossed[:, :-1, 1] = (above[:, :-1] != above[:, 1:]).transpose(2, 1, 0)
    crossed[:-1, :, 2] = (above[:, :, :-1] != above[:, :, 1:]).transpose(2, 1, 0)
    return crossed


def _triangles(above: NDArray[np.bool_], vertex: Ints) -> Ints:
    """Return the triangles of all cells, x fastest, from the vertices' numbers on the edges (nz, ny, axis, nx)."""
    corners = above.astype(np.int64).transpose(2, 1, 0)
    nz, ny, nx = (size - 1 for size in corners.shape)
    case = np.zeros((nz, ny, nx), dtype=np.int64)
    for x, y, z in np.ndindex(2, 2, 2):
        case += corners[z : z + nz, y : y + ny, x : x + nx] << (x + 2 * y + 4 * z)
    listed = [[] if word == "-" else [int(digit, 16) for digit in word] for word in TRIANGLE_CASES]
    sizes = np.array([len(edges) for edges in listed])
    k, j, i = np.nonzero(sizes[case])
    cases = case[k, j, i]
    cell = np.repeat(np.arange(len(cases)), sizes[cases])
    within = np.arange(len(cell)) - np.repeat(np.cumsum(sizes[cases]) - sizes[cases], sizes[cases])
    number = (np.cumsum(sizes) - sizes)[cases[cell]] + within
    axis, x, y, z = CUBE_EDGES[np.concatenate(listed).astype(np.int64)[number]].T
    return vertex[k[cell] + z, j[cell] + y, axis, i[cell] + x].reshape(-1, 3)
