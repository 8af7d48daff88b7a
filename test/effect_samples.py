"""What the tests of effects share: a device that shows every effect, its rows with what the linear flow leaves over, forms in envelopes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from gyro_calib.device import Device, load_device
from gyro_calib.jit import COMPILED
from gyro_calib.recording.command import Command, Excitation
from gyro_calib.simulation import GyroSimulator

compiled_only = pytest.mark.skipif(not COMPILED, reason="numba is not installed or switched off")
ComplexArray = NDArray[np.complex128]
Form = Callable[["Rows"], ComplexArray]

#: both axes driven off the middle of two modes 3 Hz apart, 5 Hz wide: envelopes of either phase on either axis
DRIVE_HZ = 15004.9
OPEN = Command("loops_off", Excitation("drive", DRIVE_HZ, 0.0, 2.0, "x"), compensation=(1.0, 0.0, 0.7, 0.0))
MODULATED = Command("ftr_x", Excitation("amplitude_modulation", 4.0, 0.3))
ALONG = np.diag([1.0, -1.0])
ACROSS = np.array([[0.0, 1.0], [1.0, 0.0]])
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
WARM_K, RATE = 8.0, -0.7


@dataclass(frozen=True)
class Rows:
    """Recorded envelopes with the linear flow of the device without effects."""

    t: NDArray[np.float64]
    p: ComplexArray
    u: ComplexArray
    volts: ComplexArray
    rest: ComplexArray
    A: ComplexArray
    G: ComplexArray
    size: Mapping[str, float]
    away_rad_s: NDArray[np.float64]

    def force(self, du: ComplexArray) -> ComplexArray:
        """What a change of the drives adds."""
        return du @ self.G.T

    def reading(self, dv: ComplexArray) -> ComplexArray:
        """What a change of the readings leaves over: it is not followed by the motion."""
        return slope(dv) - dv @ self.A.T


def slope(values: ComplexArray) -> ComplexArray:
    return np.asarray(np.gradient(values, 1.0 / 500.0, axis=0))


def slow(values: ComplexArray, tau: float) -> ComplexArray:
    """First-order low-pass of rows, from rest at the first."""
    keep = math.exp(-1.0 / 500.0 / tau)
    half = 0.5 * (1.0 - keep)
    return np.asarray(lfilter([half, half], [1.0, -keep], values - values[0], axis=0) + values[0])


def plain_device() -> Device:
    """Two modes that any drive reaches, of low Q; gains of the axes equal, so that volts of x are those of y."""
    ring = load_device("ring_15k")
    return replace(
        ring,
        resonator=replace(ring.resonator, frequency_hz=15003.7, quality_factor=3000.0, frequency_split_hz=3.0, split_azimuth_rad=0.12),
        drive=replace(ring.drive, gain_mismatch=0.0, two_delta_rad=0.0, two_lambda_rad=0.0, phase_x_rad=3e-3, phase_y_rad=-4e-3),
        pickoff=replace(ring.pickoff, gain_mismatch=0.0, non_orthogonality_rad=0.0, phase_y_rad=1e-3),
        electronics=replace(ring.electronics, dac_full_scale_v=20.0),
    )


def measured(
    plain: Device,
    effects: Mapping[str, Mapping[str, float]],
    command: Command = OPEN,
    *,
    rise_k: float = 0.0,
    rate: float = 0.0,
    settle_s: float = 1.5,
    length_s: float = 0.1,
    fidelity: str = "carrier",
) -> Rows:
    device = replace(plain, effects=effects, environment=replace(plain.environment, temperature_degc=25.0 + rise_k))
    simulator = GyroSimulator(device, rng=np.random.default_rng(0), fidelity=fidelity, noisy=False)
    simulator.configure(command)
    simulator.advance(settle_s, rate)
    rows = simulator.advance(length_s, rate)
    volts, u = (rows[:, k : k + 4 : 2] + 1j * rows[:, k + 1 : k + 4 : 2] for k in (2, 6))
    omega = 2.0 * math.pi * rows[:, 10]
    # about the frequency of the drive itself the linear steady state is exact
    flow = plain.slow_flow(rate, 25.0 + rise_k, omega_rad_s=float(omega.mean()))
    p = volts - u @ flow.E.T
    rest = slope(p) - p @ flow.A.T + 1j * (omega - omega.mean())[:, None] * p - u @ flow.G.T
    size = next(iter(effects.values()), {})
    keep = slice(5, -5)
    return Rows(rows[keep, 0], p[keep], u[keep], volts[keep], rest[keep], flow.A, flow.G, size, omega[keep] - plain.resonator.omega0_rad_s)


def assert_form(rows: Rows, expected: ComplexArray, relative: float, before: ComplexArray | float = 0.0) -> None:
    """The rest over its linear part is the form: size, sign and phase on both axes."""
    scale = float(np.abs(expected).max())
    assert scale > 1e-3
    found = float(np.abs(rows.rest - before - expected)[1:-1].max()) / scale
    assert found < relative, f"differs by {found:.3g} of the effect"


def cubes(a: ComplexArray) -> ComplexArray:
    return np.abs(a) ** 2 * a


def across_gap(r: Rows) -> ComplexArray:
    """Fundamental of ``V^2 u``."""
    return np.asarray(np.abs(r.volts) ** 2 * r.u / 2.0 + r.volts**2 * r.u.conj() / 4.0)


def coupled(r: Rows) -> ComplexArray:
    """Forces of ``x^3 y`` and ``x y^3``."""
    return 1j * _coupled(r.p, r.size["k_x"], r.size["k_y"])


def turned_cubes(r: Rows) -> ComplexArray:
    """Cubes against the velocity of each axis, and those of axes that are turned."""
    return -by_axis(r, "c_x", "c_y") * cubes(r.p) - _coupled(r.p, r.size["c_xy"], r.size["c_yx"], r.size["c_xxyy"])


def _coupled(p: ComplexArray, xy: float, yx: float, both: float = 0.0) -> ComplexArray:
    """First harmonics of ``3 x^2 y, x^3``, ``y^3, 3 x y^2`` and ``x y^2, x^2 y`` over those of a cube, by samples over a turn."""
    turn = np.exp(1j * 2.0 * np.pi * np.arange(16) / 16)[:, None]
    x, y = ((p[:, k] * turn).real for k in range(2))
    forces = xy * np.stack([3.0 * x**2 * y, x**3]) + yx * np.stack([y**3, 3.0 * x * y**2]) + both * np.stack([x * y**2, x**2 * y])
    return np.asarray(4.0 / 3.0 * 2.0 * (forces * turn.conj()).mean(axis=1).T)


def isotropic(p: ComplexArray) -> ComplexArray:
    return (2.0 * (np.abs(p) ** 2).sum(axis=1, keepdims=True) * p + (p**2).sum(axis=1, keepdims=True) * p.conj()) / 3.0


def by_axis(rows: Rows, x: str, y: str) -> NDArray[np.float64]:
    return np.array([rows.size[x], rows.size[y]])


def split(rows: Rows, c: str, s: str) -> NDArray[np.float64]:
    return rows.size[c] * ALONG + rows.size[s] * ACROSS


def clipped(amplitude: NDArray[np.float64], level: float) -> NDArray[np.float64]:
    """Fundamental of a clipped sine over the sine."""
    share = np.minimum(level / amplitude, 1.0)
    return np.asarray(2.0 / math.pi * (np.arcsin(share) + share * np.sqrt(1.0 - share**2)))


def pumps(r: Rows) -> ComplexArray:
    """Pump rates of each axis."""
    h = r.size
    return np.array([complex(h["h_xc"], h["h_xs"]), complex(h["h_yc"], h["h_ys"])])


def fed(r: Rows) -> ComplexArray:
    """Feedthrough by axis of the pick-off, a second."""
    return np.asarray(by_axis(r, "e_xc", "e_yc") + 1j * by_axis(r, "e_xs", "e_ys"))


def losses(r: Rows) -> ComplexArray:
    """The damping over its mean."""
    lossy = (r.A + r.A.T).real
    return np.asarray(2.0 * lossy / np.trace(lossy), dtype=complex)


def of_late_y(r: Rows) -> ComplexArray:
    """``V = D P``, D the phase of a y that is late: ``D A D^-1`` and ``D G`` instead of A and G, and its phase away from the frequency."""
    turn = np.diag([1.0, np.exp(-2j * math.pi * 15003.7 * r.size["tau"])])
    other = turn @ r.A @ turn.conj() - r.A
    late = -1j * r.size["tau"] * r.away_rad_s[:, None] * r.volts * np.array([0.0, 1.0])
    return np.asarray(r.p @ other.T + r.u @ (turn @ r.G - r.G).T + r.reading(late))
