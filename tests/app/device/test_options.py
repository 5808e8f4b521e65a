"""Options of a device, its axes, and refusals in a line."""

from __future__ import annotations

import pytest

import palpate as pt
from palpate.app.device.options import DeviceOptions, axes_rotation, take_device


@pytest.mark.parametrize("axes", ["XYY", "XZY", "xyz", "XY", "", "X Y Z", "-XYZ"])
def test_other_axes_are_refused(axes):
    with pytest.raises(pt.InputError, match="device_axes must be X, Y and Z once each"):
        axes_rotation(axes)


def test_options_are_taken_from_those_of_a_command():
    options = {"device": "haply:10005", "device_scale": 2.0, "device_limit": None, "part": ["liver"]}
    assert take_device(options) == DeviceOptions(device_scale=2.0, port=10005)
    assert options == {"part": ["liver"]}
    assert take_device({"device": "haply"}).port == 10001
    assert take_device({"device": None, "device_axes": None}) is None


@pytest.mark.parametrize("device", ["touch", "haply:", "haply:0", "haply:99999", "haply:1:2", "Haply"])
def test_other_devices_are_refused_in_a_line(assert_refused, device):
    assert_refused(["view", "beam", "--device", device], "--device must be haply or haply:PORT", device)


def test_options_without_a_device_and_out_of_range_are_refused(assert_refused):
    assert_refused(["view", "beam", "--device-scale", "2"], "--device-scale must be left out without --device")
    assert_refused(["run", "beam", "--device", "haply", "--device-limit", "100"], "--device-limit")
    assert_refused(["run", "beam", "--device", "haply", "--device-axes", "XZY"], "--device-axes must be")
