"""Compiled copies of nodal values to mirror images (`palpate.meshfree.mirror`)."""

from __future__ import annotations

from palpate.compiled.jit import kernel_njit


@kernel_njit(inner=True)
def fill_vectors(u, mirror, out):
    """Write vectors (n, 3) and those of their images into out (n + g, 3)."""
    n = u.shape[0]
    for i in range(n):
        for c in range(3):
            out[i, c] = u[i, c]
    for k in range(mirror.source.shape[0]):
        i = mirror.source[k]
        for c in range(3):
            out[n + k, c] = (
                mirror.reflection[k, c, 0] * u[i, 0]
                + mirror.reflection[k, c, 1] * u[i, 1]
                + mirror.reflection[k, c, 2] * u[i, 2]
            )


@kernel_njit(inner=True)
def fill_scalars(mirror, values):
    """Copy values (n + g,) of nodes to their images."""
    n = values.shape[0] - mirror.source.shape[0]
    for k in range(mirror.source.shape[0]):
        values[n + k] = values[mirror.source[k]]


@kernel_njit(inner=True)
def fill_fluxes(mirror, flux):
    """Write the reflected forces R P N and R e of fluxes (n + h, 3, 4) behind those of the nodes."""
    n = flux.shape[0] - mirror.source.shape[0]
    for k in range(mirror.source.shape[0]):
        i = mirror.source[k]
        for c in range(3):
            for d in range(4):
                flux[n + k, c, d] = (
                    mirror.reflection[k, c, 0] * flux[i, 0, d]
                    + mirror.reflection[k, c, 1] * flux[i, 1, d]
                    + mirror.reflection[k, c, 2] * flux[i, 2, d]
                )
