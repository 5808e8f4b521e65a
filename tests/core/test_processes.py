"""A child process calls a function, answers, and ends with its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from palpate.core.processes import Child


def double(receive, answer):
    """Answer twice the numbers that come, until there is none."""
    while (number := receive()) is not None:
        answer({"twice": 2 * number})


def fail(receive, answer):
    answer(receive())
    raise ValueError("no such thing")


def tell(receive, answer):
    """Answer what the process is like."""
    print("not an answer")
    answer([os.environ[receive()], os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else None])


def test_values_go_both_ways_in_their_order():
    child = Child(double, 1)
    for number in (2.5, -3, None):
        child.send(number)
    assert [answer["twice"] for answer in child.answers()] == [2, 5.0, -6]
    assert child.wait() == 0
    child.stop()


def test_a_function_that_fails_ends_with_another_exit_code():
    child = Child(fail, "first")
    assert list(child.answers()) == ["first"]
    assert child.wait() == 1
    child.send("late")
    child.stop()


def test_environment_and_priority_are_those_of_the_child():
    child = Child(tell, "PALPATE_OF_A_CHILD", environment={"PALPATE_OF_A_CHILD": "set"}, idle=True)
    (variable, niceness), = child.answers()  # fmt: skip
    child.stop()
    assert variable == "set"
    assert "PALPATE_OF_A_CHILD" not in os.environ
    assert niceness in (19, None)


def test_a_stopped_child_ends():
    child = Child(double, 1)
    assert next(child.answers()) == {"twice": 2}
    child.stop()
    assert child.wait() != 0


@pytest.mark.skipif(os.name != "posix", reason="kills and interrupts processes as POSIX does")
def test_a_child_ends_with_a_killed_parent_and_not_at_an_interrupt():
    code = (
        "from test_processes import double\nfrom palpate.core.processes import Child\n"
        "child = Child(double, 1)\nanswers = child.answers()\nprint(child.pid, next(answers), flush=True)\n"
        "input()\nchild.send(2)\nprint(next(answers), flush=True)\ninput()"
    )
    folders = os.pathsep.join([str(Path(__file__).parent), *(each for each in sys.path if each)])
    parent = subprocess.Popen(
        [sys.executable, "-P", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": folders},
    )  # fmt: skip
    pid = int(parent.stdout.readline().split()[0])
    os.kill(pid, signal.SIGINT)
    parent.stdin.write("\n")
    parent.stdin.flush()
    assert "4" in parent.stdout.readline()
    parent.kill()
    parent.wait()
    parent.stdin.close()
    parent.stdout.close()
    end = time.monotonic() + 60.0
    while is_running(pid) and time.monotonic() < end:
        time.sleep(0.05)
    assert not is_running(pid)


def is_running(pid):
    listed = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return bool(listed.stdout.strip()) and not listed.stdout.startswith("Z")
