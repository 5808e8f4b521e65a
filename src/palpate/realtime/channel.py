"""A channel in shared memory: pose and record of an engine for programs on the same machine.

The memory holds a header, then the two slots (`seqlock.Slot`) of the first tool's pose and of the record. The slots of
the poses of other tools follow. `palpate_channel.h` is the other side in C. On Linux the memory is a file in /dev/shm
that only its owner can open, on Windows a named mapping.
"""

from __future__ import annotations

import mmap
import os
import re
import struct
import sys
import weakref
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.faults import InputError, brief
from palpate.realtime.record import record_size
from palpate.realtime.seqlock import FLAGS_LENGTH, Slot

SHARED_FOLDER = Path("/dev/shm")
CHANNEL_HEADER = struct.Struct("<8sqqq32x")  # magic with the version, process, numbers of a record, tools
CHANNEL_MAGIC = b"PALPATE\2"
POSE_NUMBERS, NUMBER_BYTES = 8, 8
NAME_PATTERN = re.compile(r"[A-Za-z0-9_-]{1,60}")


def channel_header() -> Path:
    """Return the path of the C header of channels, ``palpate_channel.h``."""
    return Path(__file__).with_name("palpate_channel.h")


class SharedSlots:
    """The slots of a pose and of a record in shared memory, which is removed with this object.

    The name has letters, digits, hyphens and underscores; `coordinates` and `tools` are the numbers of the model's.
    """

    def __init__(self, name: str, coordinates: int, tools: int = 1) -> None:
        if not isinstance(name, str) or not NAME_PATTERN.fullmatch(name):
            raise InputError(
                f"shared_memory must be 1 to 60 letters, digits, hyphens or underscores, got {brief(name)}; use a name "
                "such as 'organ'"
            )
        numbers, flags = record_size(coordinates, tools), NUMBER_BYTES * FLAGS_LENGTH
        size = CHANNEL_HEADER.size + (tools + 1) * flags + NUMBER_BYTES * (tools * POSE_NUMBERS + numbers)
        memory = _map(name, size)
        memory[: CHANNEL_HEADER.size] = CHANNEL_HEADER.pack(CHANNEL_MAGIC, os.getpid(), numbers, tools)
        at = CHANNEL_HEADER.size
        slots = []
        for count in (POSE_NUMBERS, numbers):
            version = np.frombuffer(memory, dtype=np.int64, count=FLAGS_LENGTH, offset=at)
            slots.append(Slot(version, np.frombuffer(memory, dtype=np.float64, count=count, offset=at + flags)))
            at += flags + NUMBER_BYTES * count
        self.pose, self.record = slots
        more = tools - 1  # poses of the other tools: first their versions, then their values
        ints, reals = np.frombuffer(memory, np.int64, offset=at), np.frombuffer(memory, np.float64, offset=at)
        values = reals[more * FLAGS_LENGTH :][: more * POSE_NUMBERS]
        self.more_poses = Slot(
            ints[: more * FLAGS_LENGTH].reshape(more, FLAGS_LENGTH), values.reshape(more, POSE_NUMBERS)
        )


def _map(name: str, size: int) -> mmap.mmap:
    """Return new shared memory of a size [B]."""
    if sys.platform == "win32":
        windows: Any = mmap.mmap
        return windows(-1, size, tagname=name)  # type: ignore[no-any-return]
    if not SHARED_FOLDER.is_dir():
        raise InputError(f"shared_memory must be left out on this system, got {name!r}; use Linux or Windows")
    path = SHARED_FOLDER / name
    _remove_abandoned(path)
    try:
        file = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_NOFOLLOW, 0o600)
    except FileExistsError as error:
        raise InputError(f"shared_memory must be a free name, got {name!r}, which {path} has; use another") from error
    try:
        os.ftruncate(file, size)
        memory = mmap.mmap(file, size)
    finally:
        os.close(file)
    weakref.finalize(memory, _unlink, path)
    return memory


def _remove_abandoned(path: Path) -> None:
    """Remove the channel of a process that has ended."""
    try:
        content = path.read_bytes()[: CHANNEL_HEADER.size] if not path.is_symlink() else b""
        magic, process, *_ = CHANNEL_HEADER.unpack(content)
    except (OSError, struct.error):
        return
    if magic != CHANNEL_MAGIC or process <= 0:
        return
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        _unlink(path)
    except PermissionError:
        pass


def _unlink(path: Path) -> None:
    path.unlink(missing_ok=True)
