"""Compiles what ``palpate reproduce`` calls: ``python -m palpate.app.studies.compile EXAMPLE``.

It requires no packages for pictures, so that `make demo` calls it while they install.
"""

from __future__ import annotations

import sys

from palpate.app.common.compile_ahead import second_process
from palpate.app.studies.reproduce import PAPER_EXAMPLES, assist
from palpate.app.studies.study import PROJECTED, compile_study


def compile_example(name: str) -> None:
    """Compile what one of `PAPER_EXAMPLES` calls, in two processes where there are two processors."""
    example = PAPER_EXAMPLES[name]
    with second_process(assist, [name, {}, [], "", ""]) as child:
        study = next(iter(example.studies.values()))(example.case())
        compile_study(study, [PROJECTED])
        if child is not None:
            next(child.answers(), None)  # once it has compiled its part


if __name__ == "__main__":
    compile_example(sys.argv[1])
