"""Code for a target from recorded modules: linked under its data layout, optimised, and emitted as an object.

Strict code does not contract or reassociate sums. Then all targets compute the same bits, apart from the functions of
their C library.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm

__all__ = ["TARGET_MACHINES", "WEB_TARGETS", "Target", "emit_object", "host_target", "link_modules", "target_machine"]

RELAXED_FLAGS = re.compile(
    r"\b(fadd|fsub|fmul|fdiv|frem|fneg|fcmp|call|select|phi)"
    r"((?: (?:contract|reassoc|nsz|arcp|afn|nnan|ninf|fast))+) "
    r'(?!double @"?llvm\.pow)'  # Numba writes the cube root as a fast power, which LLVM then makes a cube root
)
MATH_FUNCTIONS = re.compile(
    r"(?:llvm\..*|cbrt|exp|expm1|log|log1p|pow|sqrt|sin|cos|tan|acos|asin|atan|atan2|cosh|sinh|tanh|hypot|copysign|fmod|floor|ceil|"
    r"mem(?:set|cpy|move))"
)


class Target(NamedTuple):
    """A machine that a library runs on.

    Parameters
    ----------
    triple, processor, features : str
        As LLVM names them.
    relocation : str
    """

    triple: str
    processor: str
    features: str = ""
    relocation: str = "pic"


TARGET_MACHINES = {
    "linux-x86-64-v2": Target("x86_64-unknown-linux-gnu", "x86-64-v2"),
    "linux-x86-64-v3": Target("x86_64-unknown-linux-gnu", "x86-64-v3"),
    "linux-aarch64": Target("aarch64-unknown-linux-gnu", "generic", "+neon"),
    "windows-x86-64": Target("x86_64-pc-windows-msvc", "x86-64-v3"),
    "macos-arm64": Target("arm64-apple-macos11", "apple-m1"),
}


WEB_FEATURES = "+bulk-memory,+nontrapping-fptoint,+sign-ext,+mutable-globals"
WEB_TARGETS = {
    "simd": Target("wasm32-unknown-unknown", "generic", f"+simd128,{WEB_FEATURES}", "static"),
    "scalar": Target("wasm32-unknown-unknown", "generic", WEB_FEATURES, "static"),
}


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


def emit_object(texts: Sequence[str], kept: Collection[str], target: Target, strict: bool = True) -> bytes:
    """Return the object of recorded modules in which the functions `kept` are visible; see `link_modules`."""
    machine = target_machine(target)
    module = link_modules(texts, kept, target.triple, str(machine.target_data), strict)
    tuning = llvm.create_pipeline_tuning_options(speed_level=3)
    tuning.loop_vectorization = tuning.slp_vectorization = True
    passes = llvm.create_pass_builder(machine, tuning)
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def link_modules(texts: Sequence[str], kept: Collection[str], triple: str, layout: str, strict: bool) -> Any:
    """Return one module; all its functions but those that are kept are internal.

    Raises
    ------
    RuntimeError
        A function is used that neither a module nor the C library has, such as one that allocates an array.
    """
    linked = None
    for text in reversed(texts):  # the last use the others
        text = re.sub(r"^target triple = .*$", f'target triple = "{triple}"', text, flags=re.M)
        text = re.sub(r"^target datalayout = .*$", f'target datalayout = "{layout}"', text, flags=re.M)
        module = llvm.parse_assembly(RELAXED_FLAGS.sub(r"\1 ", text) if strict else text)
        for function in module.functions:
            is_exported = function.linkage == llvm.Linkage.external and not function.is_declaration
            if is_exported and function.name not in kept:
                function.linkage = "linkonce_odr"
        if linked is None:
            linked = module
        else:
            linked.link_in(module)
    assert linked is not None
    for value in (*linked.functions, *linked.global_variables):
        if not value.is_declaration:
            value.linkage = "external" if value.name in kept else "internal"
    missing = [f.name for f in linked.functions if f.is_declaration and not MATH_FUNCTIONS.fullmatch(f.name)]
    if missing:
        raise RuntimeError(f"exported code must need the C library only, got calls of {', '.join(missing)}")
    linked.verify()
    return linked
