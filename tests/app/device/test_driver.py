"""Devices and a session: the tool follows the hand, and the page moves only what no device moves."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

import palpate as pt
from palpate.app.device.driver import driving
from palpate.app.device.options import DeviceOptions
from palpate.app.session.messages import NO_VIEWERS, validate_message

pytestmark = pytest.mark.slow


@pytest.fixture
def said():
    return []


@pytest.fixture
def held(service_of, session, said):
    """A service with a device, and the driver of a session."""
    service = service_of("049D")
    with driving(session, DeviceOptions(port=service.port, max_age=1.0), said.append) as driver:
        yield service, driver


@pytest.mark.quick
def test_a_hand_presses_the_body_of_a_session(held, session, said, until):
    service, _ = held
    device = service.devices[0]
    until(lambda: session.devices == {0: "049D"} and session.tools[0].active.kind == "sphere", lambda: said)
    top = session.surface.rest[:, 2].max()
    until(lambda: session.snapshot().tools[0].position[2] == pytest.approx(top + 0.015 + 0.01, abs=1e-6))
    depths = [0.0]

    def move_by(way):
        """Move the hand down by some millimetres, and wait until the engine has seen it."""
        depths.append(depths[-1] + way)
        service.move(depths[-1])
        steps = session.snapshot().steps
        until(lambda: session.snapshot().steps > steps + 30)

    def is_pressed():  # slowly: on a loaded machine an adapter may be late and begin again from where the hand is
        move_by(2e-4)
        return device.force[2] > 0.05

    def follows():  # by as much as the hand moves, there and back; again where an adapter was late
        tool, hand = session.snapshot().tools[0].position[2], device.position[2]
        move_by(0.001 if len(depths) % 2 else -0.001)
        until(lambda: abs(session.snapshot().tools[0].position[2] - tool) > 0.0008)
        return session.snapshot().tools[0].position[2] - tool == pytest.approx(device.position[2] - hand, abs=2e-4)

    until(is_pressed, lambda: (session.snapshot(), said))
    until(follows, lambda: (session.snapshot(), said))
    until(lambda: device.force[2] == pytest.approx(session.snapshot().tools[0].force[2], rel=0.05))
    assert said == ["haply: 049D moves tool 1"]
    assert session.status()["devices"] == [[0, "049D"]]


@pytest.mark.quick
def test_a_page_moves_no_tool_of_a_device_until_it_is_gone(held, session, until):
    service, _ = held
    until(lambda: session.devices == {0: "049D"} and session.tools[0].active.kind == "sphere")
    pose = validate_message({"type": "pose", "position": [0.0, 0.0, 0.1]})
    with pytest.raises(pt.InputError, match="pose must be of a tool without device, got that of 049D"):
        session.handle(pose)
    before = session.tool_contact()["position"]
    service.devices[0].present = False
    until(lambda: not session.devices)
    np.testing.assert_allclose(session.tool_contact()["position"], before, atol=1e-3)
    session.handle(pose)
    until(lambda: session.tool_contact()["position"][2] == pytest.approx(0.1, abs=1e-6))


def test_another_tool_of_the_page_is_moved_on_from_where_it_is(held, session, ball, until):
    service, _ = held
    until(lambda: session.tools[0].active.kind == "sphere")
    service.move(-0.05)
    until(lambda: service.devices[0].position[2] > 0.19)
    session.handle(validate_message(ball))
    until(lambda: session.tool_contact()["position"] == pytest.approx(ball["position"], abs=2e-3))
    heights = iter(np.arange(0.05, 0.2, 1e-4))

    def is_pulled():  # slowly: on a loaded machine an adapter may be late and begin again from there
        service.move(-next(heights, 0.2))
        return session.tool_contact()["position"][2] > ball["position"][2] + 0.008

    until(is_pulled)


@pytest.mark.quick
def test_a_paused_or_reset_session_gives_no_force_and_a_device_resumes_an_unwatched_one(held, session, until):
    service, _ = held
    device = service.devices[0]
    until(lambda: session.tools[0].active.kind == "sphere")
    depths = iter(np.arange(0.0, 0.1, 1e-4))

    def is_pressed():  # deeper and deeper: after a pause the hand continues from where the tool is
        service.move(next(depths))
        return device.force[2] > 0.05

    until(is_pressed)
    session.pause()
    until(lambda: device.force == [0.0, 0.0, 0.0])
    session.resume()
    until(is_pressed)
    session.reset()
    until(lambda: device.force == [0.0, 0.0, 0.0])
    service.move(-0.02)
    until(lambda: session.tools[0].active.kind == "sphere")
    session.pause(NO_VIEWERS)
    device.present = False
    until(lambda: not session.devices)
    device.present = True
    until(lambda: session.devices and session.pause_reason is None)


def test_a_killed_adapter_is_started_again(held, session, said, until):
    service, driver = held
    until(lambda: session.devices)
    first = driver.process
    os.kill(driver.process, signal.SIGKILL)
    until(lambda: driver.process != first and service.emulator.connections == 2 and session.devices)
    assert any("the process of the device ended" in text for text in said)


def test_the_force_of_a_coupled_tool_is_that_of_its_spring(session, ball, until):
    session.handle(validate_message({**ball, "stiffness": 200.0}))
    session.handle(validate_message({"type": "pose", "position": [*ball["position"][:2], ball["position"][2] - 0.006]}))
    until(lambda: session.tool_contact()["force"][2] > 0.05)
    until(
        lambda: np.linalg.norm(np.subtract(session.tool_contact()["force"], session.snapshot().tools[0].force)) < 5e-3
    )
    stiffness = np.reshape(session.tool_contact()["stiffness"], (3, 3))
    alone = session.engine.read().stiffness
    np.testing.assert_allclose(np.linalg.inv(stiffness + 1e-9 * np.eye(3))[2, 2] - 1 / 200.0,
                               np.linalg.inv(alone + 1e-9 * np.eye(3))[2, 2], rtol=0.05)  # fmt: skip


def test_two_hands_press_the_body_each_with_a_tool(service_of, session, said, until):
    service = service_of("L001", "R002")
    with driving(session, DeviceOptions(port=service.port, max_age=1.0), said.append):
        until(lambda: session.devices == {0: "R002", 1: "L001"}, lambda: said)
        until(lambda: [tool.active.kind for tool in session.tools[:2]] == ["sphere", "sphere"], lambda: said)
        service.move(0.02, k=1)  # the right one
        until(lambda: service.devices[1].force[2] > 0.05, lambda: said)
        assert service.devices[0].force == [0.0, 0.0, 0.0]
        pose = validate_message({"type": "pose", "position": [0.0, 0.0, 0.1], "index": 1})
        with pytest.raises(pt.InputError, match="got that of L001"):
            session.handle(pose)
        first, second = session.tool_contact(0)["position"], session.tool_contact(1)["position"]
        assert first[0] > second[0] + 0.02
        assert first[2] < second[2]
