"""A reduced model as functions without Python: their modules, the memory they work in, and objects for targets."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import InputError, integer_in_range
from palpate.export.digest import DIGEST_WORDS, check_file
from palpate.export.entries import OPTION_NAMES, compile_step, exchange_tool, reset_model, write_vertices
from palpate.export.link import emit_object
from palpate.export.lowering import LoweredFunction, recording
from palpate.export.memory import DIGEST_PLACE, Memory, constant_function
from palpate.export.targets import Target
from palpate.realtime.bodies.display_surface import Surface
from palpate.realtime.bodies.model import idle_model
from palpate.realtime.contract import MAX_TOOLS
from palpate.realtime.instrumented import TOOLS, make_instrumented
from palpate.realtime.period import IGNORE, Work
from palpate.realtime.pose import IDENTITY_POSE
from palpate.reduction.hyper.error_indicator import bound_curve, forgetting_rate
from palpate.reduction.hyper.model import ReducedModel

FUNCTION_NAMES = ("step", "reset", "set_tool", "vertices", "check", "memory_size", "file_size")  # of every library
CHECKED_LENGTH = 7  # place of the length among the flat arguments of `check_file`, after an array
DEFAULT_OPTIONS = {
    "period": 1e-3, "force_limit": np.inf, "max_speed": 2.0, "max_angular_speed": 10.0, "stiffness_every": 50.0,
    "out_of_training": float(IGNORE),
}  # fmt: skip


class Library(NamedTuple):
    """Functions of a model before they are compiled for a target; `_replace` gives them another name."""

    name: str  # with which the names of all functions begin, an identifier of C
    model: ReducedModel
    texts: list[str]  # modules of LLVM's intermediate representation
    functions: list[LoweredFunction]
    memory: Memory
    image: bytes  # content of the model's file

    def emit(self, target: Target, strict: bool = True) -> bytes:
        """Return the object of the functions for a target; see `palpate.export.link.emit_object`."""
        entries = [self.memory.entry_point(f"{self.name}_{each.name}", each) for each in self.functions]
        sizes = {"memory_size": self.memory.size, "file_size": self.memory.stored}
        entries += [constant_function(f"{self.name}_{key}", value) for key, value in sizes.items()]
        return emit_object([*self.texts, *entries], self.symbols, target, strict)

    @property
    def symbols(self) -> list[str]:
        """Names of the functions."""
        return [f"{self.name}_{function}" for function in FUNCTION_NAMES]


def check_library(name: str, tools: int) -> None:
    """Raise `InputError` unless a name is an identifier of C, and tools are 1 to `MAX_TOOLS`."""
    if not (name.isascii() and name.isidentifier()):
        raise InputError(f"name must be an identifier of C, got {name!r}; use letters, digits and underscores")
    integer_in_range("tools", tools, 1, MAX_TOOLS)


def lower_model(model: ReducedModel, name: str, tools: int = 2) -> Library:
    """Return the library of a reduced model; no compiled function can be called in this process afterwards.

    The model has tool contact, or one prescribed group. `name` and `tools` are as for `check_library`; a group is one
    tool.
    """
    check_library(name, tools)
    functions, named = model_functions(model, tools)
    placeholder, scratch, digest = np.zeros(0, dtype=np.uint8), np.zeros((2, 64), dtype=np.int64), (0,) * DIGEST_WORDS
    functions["check"] = check_file, (placeholder, 0, scratch[0], scratch[1], digest)
    with recording() as texts:
        lowered = [LoweredFunction(key, *each) for key, each in functions.items()]
    memory = Memory(lowered, named)
    image = memory.image()
    words = [int.from_bytes(image[DIGEST_PLACE + 4 * k : DIGEST_PLACE + 4 * k + 4], "big") for k in range(DIGEST_WORDS)]
    check = lowered[-1].leaves
    check[-DIGEST_WORDS:] = words
    check[CHECKED_LENGTH] = memory.stored
    return Library(name, model, texts, lowered, memory, image)


def model_functions(
    model: ReducedModel, tools: int
) -> tuple[dict[str, tuple[Any, tuple[Any, ...]]], dict[str, NDArray[Any]]]:
    """Return the functions of a library with their arguments, and the arrays that a program uses by name."""
    ready = idle_model(model, tools=tools)
    instrumented = make_instrumented(ready, linked=True)
    surface, data = Surface(model), instrumented.data
    count = len(data.coupling.position)
    work = Work.at_rest(instrumented.rest, instrumented.tool, forgetting_rate(model.report))
    columns, patch_columns, places = surface.tables(ready.data.contact_surface.nodes)
    named: dict[str, NDArray[Any]] = {
        "pose": np.tile(IDENTITY_POSE, (count, 1)),
        "options": np.array([DEFAULT_OPTIONS[name] for name in OPTION_NAMES]),
        "record": work.record,
        "force_bound": np.full(count, np.inf),
        "modulus_ratio": data.modulus_ratio,
        "coupling": data.coupling.parameters,
        "tool_position": data.values[TOOLS + 3 * count : TOOLS + 6 * count].reshape(count, 3),
        "tool_index": np.zeros(1, dtype=np.int64),
        "tool_kind": np.full(1, -1),
        "tool_sizes": np.zeros(3),
        "tool_friction": np.zeros(1),
        "tool_point": np.zeros(3),
        "tool_pose": IDENTITY_POSE.copy(),
        "vertices": surface.rest.copy(),
        "rest": surface.rest,
        "triangles": surface.triangles,
        "fixed": surface.fixed.astype(np.uint8),
    }
    compliance = ready.data.contact_surface.compliance
    fields = np.zeros(2 * compliance.flexibility.shape[0] + 3 * (compliance.members.shape[0] // 2))
    step = compile_step(instrumented.advance, instrumented.stiffness)
    n, curve = named, bound_curve(model.report)
    tool = (n["tool_index"], n["tool_kind"], n["tool_sizes"], n["tool_friction"], n["tool_point"], n["tool_pose"])
    return {
        "step": (step, (data, work, n["pose"], n["options"], curve, n["force_bound"])),
        "reset": (reset_model, (data, work, instrumented.rest)),
        "set_tool": (exchange_tool, (data, work, *tool)),
        "vertices": (
            write_vertices, (data, work.q, n["rest"], columns, patch_columns, places, fields, n["vertices"])
        ),
    }, named  # fmt: skip
