"""A channel in shared memory: poses and records of another program, its names, and what is left behind."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.realtime.channel import CHANNEL_HEADER, CHANNEL_MAGIC, SHARED_FOLDER, channel_header
from palpate.realtime.record import HEADER_DTYPE, HEADER_SIZE, TOOL_DTYPE, TOOL_SIZE, field_offset

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="uses /dev/shm")
NAME = f"palpate-test-{os.getpid()}"


@pytest.fixture(scope="module")
def model():
    cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    return pt.realtime_model(pt.Solid(cloud, tissue, fixed="z-", mass_damping=8), contact=ball)


def test_the_header_has_the_records_fields():
    text = channel_header().read_text(encoding="utf-8")
    numbers = dict(re.findall(r"PALPATE_CHANNEL_([A-Z_]+) = (\d+)", text))
    assert int(numbers.pop("SIZE")) == HEADER_SIZE
    assert int(numbers.pop("TOOL_SIZE")) == TOOL_SIZE
    for name, place in numbers.items():
        fields, field = (TOOL_DTYPE, name[5:]) if name.startswith("TOOL_") else (HEADER_DTYPE, name)
        assert int(place) == field_offset({"PERIODS": "steps"}.get(field, field.lower()), fields)
    assert len(text.splitlines()) < 150


ENGINE = """
import sys, time, palpate as pt
tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
block = pt.Solid(pt.box((0.03, 0.03, 0.015), spacing=0.005), tissue, fixed="z-", mass_damping=8)
ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
with pt.Engine(pt.realtime_model(block, contact=ball), shared_memory=sys.argv[1]) as engine:
    print("ready", flush=True)
    while sys.stdin.readline():
        engine.pause()
        print("paused", flush=True)
"""
READER = r"""
#include <stdio.h>
#include "palpate_channel.h"
int main(int argc, char **argv) {
    palpate_channel c;
    double pose[7] = {0, 0, -0.004, 1, 0, 0, 0}, r[PALPATE_CHANNEL_SIZE];
    if (argc < 2 || palpate_channel_open(&c, argv[1])) return 1;
    palpate_channel_write(&c, pose, 1);
    while (getchar() != EOF) {
        while (palpate_channel_read(&c, r)) {}
        printf("%.6f\n", r[PALPATE_CHANNEL_FORCE + 2]);
        fflush(stdout);
    }
    return 0;
}
"""


@pytest.mark.quick(end=["pause"])
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("end", ["pause", signal.SIGSTOP, signal.SIGKILL])
def test_the_force_of_an_engine_that_no_longer_steps_is_zero(tmp_path, end):
    program, source, name = tmp_path / "reader", tmp_path / "reader.c", f"{NAME}-{int(end) if end != 'pause' else 0}"
    source.write_text(READER, encoding="utf-8")
    subprocess.run(["cc", f"-I{channel_header().parent}", source, "-lrt", "-o", program], check=True)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "bufsize": 1}
    with subprocess.Popen([sys.executable, "-c", ENGINE, name], **pipes) as engine:
        assert engine.stdout.readline() == "ready\n"
        with subprocess.Popen([program, name], **pipes) as reader:

            def force():
                reader.stdin.write("\n")
                return float(reader.stdout.readline())

            force()
            time.sleep(0.5)
            assert force() > 0.01
            if end == "pause":
                engine.stdin.write("\n")
                assert engine.stdout.readline() == "paused\n"
            else:
                engine.send_signal(end)
            time.sleep(0.2)
            assert force() == 0.0
            assert force() == 0.0
            reader.stdin.close()
        engine.kill()
    assert subprocess.run([program, name], check=False, stdin=subprocess.DEVNULL).returncode == 1
    (SHARED_FOLDER / name).unlink(missing_ok=True)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("compiler", ["cc", "g++"])
def test_a_program_presses_through_the_channel(model, tmp_path, compiler):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    program, source = tmp_path / "client", Path(__file__).with_name("channel_client.c")
    warnings = ["-Wall", "-Wextra", "-Werror", *(["-x", "c++"] if compiler == "g++" else [])]
    folder = f"-I{channel_header().parent}"
    subprocess.run([compiler, "-O2", *warnings, folder, source, "-x", "none", "-lrt", "-o", program], check=True)
    with pt.Engine(model, shared_memory=NAME) as engine:
        done = subprocess.run([program, NAME, "300"], capture_output=True, text=True, check=True, timeout=300)
        time.sleep(0.2)
        reading = engine.read()
        times, record = (np.array(line.split(), dtype=float) for line in done.stdout.splitlines())
        assert times[0] < 50.0  # [us] of an exchange in the median
        assert record[0] == pytest.approx(-0.004) == reading.position[2]  # a pose that is not a number is not taken
        assert record[1] > 0.0
        assert reading.sequence == 300
        assert reading.state == "running"
        with pytest.raises(pt.InputError, match="through the shared memory"):
            engine.set_pose((0.0, 0.0, 0.0))


def test_a_channel_belongs_to_its_owner_and_goes_with_the_engine(model):
    engine = pt.Engine(model, shared_memory=NAME)
    path = SHARED_FOLDER / NAME
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(pt.InputError, match="free name"):
        pt.Engine(model, shared_memory=NAME)
    del engine
    assert not path.exists()


def test_the_channel_of_a_program_that_died_is_replaced(model):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    path = SHARED_FOLDER / NAME
    path.write_bytes(CHANNEL_HEADER.pack(CHANNEL_MAGIC, ended.pid, 0, 1))
    engine = pt.Engine(model, shared_memory=NAME)
    assert path.stat().st_size > CHANNEL_HEADER.size
    del engine


@pytest.mark.parametrize("name", ["", "a/b", "../x", "x" * 61, 3, "é"])
def test_bad_names_are_refused(model, name):
    with pytest.raises(pt.InputError, match="shared_memory must be"):
        pt.Engine(model, shared_memory=name)


def test_foreign_files_are_kept(model):
    path = SHARED_FOLDER / NAME
    path.write_bytes(b"someone else's")
    try:
        with pytest.raises(pt.InputError, match="free name"):
            pt.Engine(model, shared_memory=NAME)
        assert path.read_bytes() == b"someone else's"
    finally:
        path.unlink()
