"""Compiled code: how kernels are compiled, kept on disk, and laid out in memory.

**Compile.** `jit.kernel_njit` compiles a kernel, and `jit.law_njit` one of the functions that a law, a formulation or a
variant of a body makes. Both wrap `numba.njit`, give the function a unique name, and keep its machine code on disk.
Fast-math flags, the error model and forced inlining are those of the function itself, off by default. Numba takes them
from the function that calls it first, so that bits would depend on the order of compiling. A kernel that is contracted
with its caller has ``fastmath={"contract"}`` as well. Literal integers in a call compile no version of their own.

**Cache and digest.** The key of a kernel is a digest (`code_digest`) of its bytecode, its law, its options, and the
modules of compiled functions that it imports. An edit recompiles only what uses it. `code_cache` keeps the code in one
folder of the user, for all clones and environments; `shipped_code` reads what the package ``palpate-kernels`` brings.

**Guards.** Machine code is run, so nothing is read that others than root and the user can write. Damaged files count as
missing. `palpate.core.working_folder` hides the settings of Numba in the working folder. `threads` finds whether two
threads may run parallel loops at once, and refuses children of forks.

**Lanes.** `lanes` sums over stencils for `LANES` nodes at once, one node in each lane of a vector register. `passes`
are the two passes over such blocks that solids and membranes share: derivatives and stress, then forces.

**Rows.** `rows` sums one node at a time, with the numbers of a node next to each other. It is quicker where the nodes
of a block have different neighbours. `transposes` converts between the two layouts in registers. `mirror` fills the
images of nodes behind a plane of symmetry, and `eigenvectors` holds those of symmetric 3 by 3 matrices.

**References.** A large record is passed by its address (`reference`), because Numba passes every number and every field
of every array of a named tuple as an argument of its own.

Results have the same bits for any number of threads, since each node is computed independently of the others, and for
any order in which processes compile.
"""
