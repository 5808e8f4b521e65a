"""Code for a target from recorded modules: linked under its data layout, optimised, and emitted as an object.

Strict code does not contract or reassociate sums. Then all targets compute the same bits, apart from the functions of
their C library.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any

import llvmlite.binding as llvm

from palpate.export.targets import Target

RELAXED_FLAGS = re.compile(
    r"\b(fadd|fsub|fmul|fdiv|frem|fneg|fcmp|call|select|phi)"
    r"((?: (?:contract|reassoc|nsz|arcp|afn|nnan|ninf|fast))+) "
    r'(?!double @"?llvm\.pow)'  # Numba writes the cube root as a fast power, which LLVM then makes a cube root
)
MATH_FUNCTIONS = re.compile(
    r"(?:llvm\..*|cbrt|exp|expm1|log|log1p|pow|sqrt|sin|cos|tan|acos|asin|atan|atan2|cosh|sinh|tanh|hypot|copysign|"
    r"fmod|floor|ceil|mem(?:set|cpy|move))"
)


def host_target() -> Target:
    """Return the target of this machine and processor."""
    features = llvm.get_host_cpu_features().flatten()
    return Target(llvm.get_default_triple(), llvm.get_host_cpu_name(), features)


def target_machine(target: Target) -> Any:
    """Return LLVM's machine of a target."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.processor, features=target.features, opt=3, reloc=target.relocation
    )


def emit_object(texts: Sequence[str], exported: Collection[str], target: Target, strict: bool = True) -> bytes:
    """Return the object of recorded modules in which the functions `exported` are visible; see `link_modules`."""
    machine = target_machine(target)
    module = link_modules(texts, exported, target.triple, str(machine.target_data), strict)
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = True
    passes = llvm.create_pass_builder(machine, tuning)
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def link_modules(texts: Sequence[str], exported: Collection[str], triple: str, layout: str, strict: bool) -> Any:
    """Return one module; all its functions but those that are kept are internal."""
    linked = None
    for text in reversed(texts):  # the last use the others
        text = re.sub(r"^target triple = .*$", f'target triple = "{triple}"', text, flags=re.M)
        text = re.sub(r"^target datalayout = .*$", f'target datalayout = "{layout}"', text, flags=re.M)
        module = llvm.parse_assembly(RELAXED_FLAGS.sub(r"\1 ", text) if strict else text)
        for function in module.functions:
            is_exported = function.linkage == llvm.Linkage.external and not function.is_declaration
            if is_exported and function.name not in exported:
                function.linkage = "linkonce_odr"
        if linked is None:
            linked = module
        else:
            linked.link_in(module)
    assert linked is not None
    for value in (*linked.functions, *linked.global_variables):
        if not value.is_declaration:
            value.linkage = "external" if value.name in exported else "internal"
    missing = [f.name for f in linked.functions if f.is_declaration and not MATH_FUNCTIONS.fullmatch(f.name)]
    if missing:
        raise RuntimeError(f"exported code must need the C library only, got calls of {', '.join(missing)}")
    linked.verify()
    return linked
