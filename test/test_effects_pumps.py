"""A stiffness that the amplitude loop pumps at twice the reference, at the carrier, against its closed form."""

from __future__ import annotations

import numpy as np
import pytest
from effect_samples import MODULATED, OPEN, compiled_only, measured, plain_device, pumps

from gyro_calib.device import Device
from gyro_calib.recording.command import Command


@pytest.fixture(scope="module")
def plain() -> Device:
    return plain_device()


@compiled_only
@pytest.mark.parametrize("command", [MODULATED, OPEN])
def test_amplitude_loop_pumps_as_much_as_it_commands(plain: Device, command: Command) -> None:
    """What goes along the velocity of a mode on x; nothing while the loops are off."""
    sizes = {"h_xc": 0.3, "h_xs": 0.2, "h_yc": -0.2, "h_ys": 0.1}
    # a thinned row is a mean of some control periods, each with the command of its own
    rows, before = (measured(plain, e, command, settle_s=2.0, length_s=0.5) for e in ({"driven_pump": sizes}, {}))
    along = ((1j * rows.p).conj() * rows.u).real.sum(axis=1, keepdims=True) / np.linalg.norm(rows.p, axis=1, keepdims=True)
    assert np.ptp(along) > (0.1 if command is MODULATED else 0.0) * np.abs(along).max()
    expected = pumps(rows) * along * rows.p.conj()
    scale = np.abs(expected).max()
    closed = 1.0 if command is MODULATED else 0.0
    assert scale > 1e-3
    assert np.abs(rows.rest - before.rest - closed * expected)[5:-5].max() / scale < 0.02
