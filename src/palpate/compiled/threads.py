"""Threads of compiled loops: whether several threads of a program may run them at once, and children of forks.

Numba runs parallel loops by one of three layers. TBB and OpenMP may be used by several threads at once, as by an engine
next to a run. The third, ``workqueue``, ends the process then. It is all there is on a Mac without OpenMP. There loops
are compiled without threads: they are slower, and their results have the same bits.
"""

from __future__ import annotations

import importlib
import os

import numba
import numba.np.ufunc.parallel as numba_threads

from palpate.core.faults import InputError

LAYER_MODULES = {"tbb": "tbbpool", "omp": "omppool"}  # of the layers that several threads may use


def _loads(layer: str) -> bool:
    try:
        importlib.import_module(f"numba.np.ufunc.{LAYER_MODULES[layer]}")
    except ImportError:
        return False
    return True


def _find_layer() -> str:
    """Return the layer that Numba takes."""
    if numba.config.THREADING_LAYER in (*LAYER_MODULES, "workqueue"):
        return str(numba.config.THREADING_LAYER)
    order = [each for each in numba.config.THREADING_LAYER_PRIORITY if each not in LAYER_MODULES or _loads(each)]
    return str(order[0]) if order else "workqueue"


THREADING_LAYER = _find_layer()


def loops_share_threads() -> bool:
    """Return whether several threads may run parallel loops at once; else loops are compiled without threads."""
    return THREADING_LAYER != "workqueue"


_broken_forks: list[int] = []  # the process, if it was forked while OpenMP's threads ran


def _note_fork() -> None:
    if THREADING_LAYER == "omp" and numba_threads._is_initialized:
        _broken_forks[:] = [os.getpid()]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


def check_process() -> None:
    """Check that this process can run parallel loops."""
    if _broken_forks:
        raise InputError(
            f"process {os.getpid()} must not be forked from one that has run palpate, since OpenMP ends its threads "
            "there; use multiprocessing.get_context('spawn') or 'forkserver'"
        )
