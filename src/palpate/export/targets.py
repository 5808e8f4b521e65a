"""The machines that libraries are compiled for."""

from __future__ import annotations

from typing import NamedTuple


class Target(NamedTuple):
    """A machine that a library runs on."""

    # triple, processor, features: as LLVM names them
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
HOST_TARGET = "host"  # this machine
TARGET_NAMES = (HOST_TARGET, *TARGET_MACHINES)

WEB_FEATURES = "+bulk-memory,+nontrapping-fptoint,+sign-ext,+mutable-globals"
WEB_TARGETS = {
    "simd": Target("wasm32-unknown-unknown", "generic", f"+simd128,{WEB_FEATURES}", "static"),
    "scalar": Target("wasm32-unknown-unknown", "generic", WEB_FEATURES, "static"),
}
