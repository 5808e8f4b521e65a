"""The kernels of a period lower without allocations and without Python."""

from __future__ import annotations

import subprocess
import sys

LOWER = """
import sys
import palpate as pt
from palpate.export.library import lower_model
from palpate.export.link import host_target, link_modules, target_machine
library, target = lower_model(pt.load(sys.argv[1]), "organ"), host_target()
module = link_modules(library.texts, library.symbols, target.triple, str(target_machine(target).target_data), True)
kept = [f.name for f in module.functions if not f.is_declaration and f.linkage.name == "external"]
print(*sorted(kept))
print(library.memory.stored < library.memory.size, len(library.image) == library.memory.stored)
"""


def test_no_kernel_of_a_period_allocates_or_calls_python(model_file):
    done = subprocess.run([sys.executable, "-c", LOWER, str(model_file)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # a call of Numba's runtime or of Python is refused
    names, sizes = done.stdout.splitlines()
    functions = ("check", "file_size", "memory_size", "reset", "set_tool", "step", "vertices")
    assert names.split() == [f"organ_{name}" for name in functions]
    assert sizes.split() == ["True", "True"]
