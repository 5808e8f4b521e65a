"""Eigenvalues and eigenvectors of a symmetric matrix of three rows, compiled.

The eigenvalue farthest from the other two is the root of largest size of b^3 - 3 b - 2 h = 0, of the
scaled deviator. That root depends smoothly on h, and three Newton steps from a parabola compute
it to the last bit. Its eigenvector is the largest cross product of two rows (Eberly, A Robust
Eigensolver for 3x3 Symmetric Matrices, 2014). One Jacobi rotation in the normal plane separates the
other two. No eigenvalue is divided by its distance from another, so equal ones are not a special
case: the directions are always orthonormal, and arbitrary for equal eigenvalues.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit

MIN_DIVISOR = 1e-300  # added to divisors that can vanish


@kernel_njit(fastmath={"contract"}, forceinline=True)
def principal(C00, C11, C22, C01, C02, C12):
    """Return the eigenvalues of a symmetric matrix, unordered, and the matrix of its eigenvectors row by row."""
    mean = (C00 + C11 + C22) / 3.0
    a, b, c = C00 - mean, C11 - mean, C22 - mean
    size = np.sqrt((a * a + b * b + c * c + 2.0 * (C01 * C01 + C02 * C02 + C12 * C12)) / 6.0 + MIN_DIVISOR)
    scale = 1.0 / size
    a, b, c, d, e, f = a * scale, b * scale, c * scale, C01 * scale, C02 * scale, C12 * scale
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e))
    sign = 1.0 if half >= 0.0 else -1.0
    h = min(sign * half, 1.0)
    root = 1.7320508 + h * (0.3334 - 0.0655 * h)
    for _ in range(3):
        square = root * root
        root -= (root * (square - 3.0) - 2.0 * h) / (3.0 * (square - 1.0))
    far = sign * root
    # rows of the deviator minus its farthest eigenvalue span the plane normal to its eigenvector
    a, b, c = a - far, b - far, c - far
    x0, x1, x2 = d * f - e * b, e * d - a * f, a * b - d * d
    y0, y1, y2 = d * c - e * f, e * e - a * c, a * f - d * e
    z0, z1, z2 = b * c - f * f, f * e - d * c, d * f - b * e
    xx, yy, zz = x0 * x0 + x1 * x1 + x2 * x2, y0 * y0 + y1 * y1 + y2 * y2, z0 * z0 + z1 * z1 + z2 * z2
    if yy > xx:
        x0, x1, x2, xx = y0, y1, y2, yy
    if zz > xx:
        x0, x1, x2, xx = z0, z1, z2, zz
    if xx < 1e-30:  # a multiple of the unit matrix: any direction
        x0, x1, x2, xx = 1.0, 0.0, 0.0, 1.0
    r = 1.0 / np.sqrt(xx)
    n00, n10, n20 = x0 * r, x1 * r, x2 * r
    # a basis of the normal plane (Duff and others, J. Comput. Graph. Tech. 6, 2017)
    s = 1.0 if n20 >= 0.0 else -1.0
    t = -1.0 / (s + n20)
    q = n00 * n10 * t
    u0, u1, u2 = 1.0 + s * n00 * n00 * t, s * q, -s * n00
    v0, v1, v2 = q, s + n10 * n10 * t, -n10
    Cu0, Cu1, Cu2 = C00 * u0 + C01 * u1 + C02 * u2, C01 * u0 + C11 * u1 + C12 * u2, C02 * u0 + C12 * u1 + C22 * u2
    Cv0, Cv1, Cv2 = C00 * v0 + C01 * v1 + C02 * v2, C01 * v0 + C11 * v1 + C12 * v2, C02 * v0 + C12 * v1 + C22 * v2
    Cn0, Cn1 = C00 * n00 + C01 * n10 + C02 * n20, C01 * n00 + C11 * n10 + C12 * n20
    Cn2 = C02 * n00 + C12 * n10 + C22 * n20
    uu, vv, uv = u0 * Cu0 + u1 * Cu1 + u2 * Cu2, v0 * Cv0 + v1 * Cv1 + v2 * Cv2, u0 * Cv0 + u1 * Cv1 + u2 * Cv2
    # tangent of the smaller angle of the Jacobi rotation
    gap = 0.5 * (vv - uu)
    radius = abs(gap) + np.sqrt(gap * gap + uv * uv) + MIN_DIVISOR
    tangent = (uv if gap >= 0.0 else -uv) / radius
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    sine = tangent * cosine
    return (
        (n00 * Cn0 + n10 * Cn1 + n20 * Cn2, uu - tangent * uv, vv + tangent * uv),
        (
            n00, cosine * u0 - sine * v0, sine * u0 + cosine * v0,
            n10, cosine * u1 - sine * v1, sine * u1 + cosine * v1,
            n20, cosine * u2 - sine * v2, sine * u2 + cosine * v2,
        ),
    )  # fmt: skip
