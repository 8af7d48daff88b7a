"""A unit: what a gyro and its electronics are, drawn from healthy ranges, and its linear part as one matrix."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from kernel import Array

TWO_PI = 2.0 * math.pi


@dataclass(frozen=True)
class Unit:
    """A healthy unit.

    Displacement is measured in volts of the nominal pick-off, velocity in the same volts through ``w0``. Matrices act on (x, y).
    """

    kind: str
    name: str
    f0: float
    q: float
    kappa: float
    gain: float  # |G| [V/s per V], nominal
    split: tuple[float, float]  # cos and sin part of the stiffness anisotropy [rad/s]
    damping_split: tuple[float, float]  # same of 1/tau [1/s]
    drive: Array  # relative drive gains
    pick: Array  # relative pick-off gains
    drive_pole: Array  # [rad/s]
    pick_pole: Array
    feed_direct: Array
    feed_slow: Array
    rate: float  # constant rate of the bench [rad/s]
    noise_v: float  # pick-off, volts per root hertz of envelope
    noise_w: float  # thermal walk of the envelope, volts per root second
    row_rate: float
    window: int  # samples per window of the loops
    decimation: int  # windows per row
    substeps: int
    row_band: float  # pass band of the rows, share of the row rate
    latency: int  # windows
    loops: dict[str, float]
    tc: dict[str, float]  # healthy temperature coefficients, per kelvin
    wander: dict[str, float]
    thermometer: dict[str, float]
    heater_lag: float
    table: dict[str, float]
    body: tuple[float, float]

    @property
    def w0(self) -> float:
        """Angular frequency [rad/s]."""
        return TWO_PI * self.f0

    @property
    def loop_rate(self) -> float:
        """Windows per second."""
        return self.row_rate * self.decimation

    @property
    def adc_rate(self) -> float:
        """Samples per second."""
        return self.loop_rate * self.window

    @property
    def tau(self) -> float:
        """Time constant of the amplitude [s]."""
        return 2.0 * self.q / self.w0

    def generator(self) -> tuple[Array, Array]:
        """Continuous state and input matrices, in the order of plant.c."""
        a, b = np.zeros((10, 10)), np.zeros((10, 2))
        (kc, ks), (dc, ds) = self.split, self.damping_split
        a[0:2, 2:4] = self.w0 * np.eye(2)
        a[2:4, 0:2] = -self.w0 * np.eye(2) - np.array([[kc, ks], [ks, -kc]])
        a[2:4, 2:4] = -2.0 / self.tau * np.eye(2) - np.array([[dc, ds], [ds, -dc]])
        a[2:4, 4:6] = 2.0 * self.gain * self.drive
        a[4:6, 4:6], b[4:6] = -np.diag(self.drive_pole), np.diag(self.drive_pole)
        a[6:8, 6:8], b[6:8] = -self.w0 * np.eye(2), self.w0 * np.eye(2)
        pole = self.pick_pole[:, None]
        a[8:10, 0:2], a[8:10, 6:8], a[8:10, 8:10] = pole * self.pick, pole * self.feed_slow, -np.diag(self.pick_pole)
        b[8:10] = pole * self.feed_direct
        return a, b

    def propagator(self) -> Array:
        """State and input matrix of one sub-step with the drive held."""
        a, b = self.generator()
        block = np.zeros((12, 12))
        block[:10, :10], block[:10, 10:] = a, b
        return np.asarray(expm(block * self.substep)[:10])

    @property
    def substep(self) -> float:
        """Length of a sub-step [s]."""
        return 1.0 / (self.adc_rate * self.substeps)

    def parameters(self) -> dict[str, float]:
        """What plant.c is told of a healthy unit."""
        tick = 1.0 / self.adc_rate
        return {
            "H": self.substep,
            "M": self.substeps,
            "R": self.window,
            "W0": self.w0,
            "KAPPA": self.kappa,
            "ADVANCE": self.advance,
            "DELAY_W": self.latency,
            "DAC_FS": 5.0,
            "ADC_FS": 2.5,
            "DAC_LSB": 10.0 / 2**20,
            "ADC_LSB": 5.0 / 2**18,
            "SIGMA_V": self.noise_v / math.sqrt(4.0 * tick),
            "SIGMA_W": self.noise_w,
            "BODY_GAIN": self.body[0],
            "BODY_PHASE": self.body[1],
            "GNOM": self.gain,
            "SLOW_DT": 2e-3,
            "UMAX": 4.6,
            "ALOCK": 0.03,
            **self.loops,
        }

    @property
    def advance(self) -> float:
        """Phase by which the firmware leads the drive: half the hold of the converter, at the nominal frequency."""
        return math.pi * self.nominal_f0 / self.adc_rate

    @property
    def nominal_f0(self) -> float:
        """Frequency on the data sheet [Hz]."""
        return 15000.0 if self.kind == "ring" else 5000.0

    def factory(self) -> dict[str, object]:
        """What left the factory with the unit."""
        chain = np.abs(self.drive_pole / (self.drive_pole + 1j * self.w0))
        return {
            "unit": self.name,
            "kind": self.kind,
            "angular_gain_kappa": self.kappa,
            "nominal_f0_hz": self.nominal_f0,
            "nominal_q": 30000.0 if self.kind == "ring" else 2e5,
            "drive_gain_ratio_x_over_y": float(self.drive[0, 0] * chain[0] / (self.drive[1, 1] * chain[1])),
            "reference_temperature_degC": 25.0,
            "dac_full_scale_V": 5.0,
            "adc_full_scale_V": 2.5,
        }


def _clocks(rng: np.random.Generator, ring: bool, f0: float) -> tuple[float, int, int]:
    """Row rate, window and decimation such that no image of the carrier folds to where something is read."""
    rows = (100.0, 200.0, 250.0, 400.0, 500.0) if ring else (100.0, 125.0, 200.0, 250.0, 400.0)
    while True:
        row = float(rng.choice(rows))
        per_period = rng.uniform(4.15, 7.8)
        loop = rng.uniform(2500.0, 5000.0) if ring else rng.uniform(1200.0, 2600.0)
        decimation = round(loop / row)
        window = round(per_period * f0 / (row * decimation))
        loop, adc = row * decimation, row * decimation * window
        image = abs(2 * f0 / loop - round(2 * f0 / loop)) * loop
        if min(image, abs(f0 / loop - round(f0 / loop)) * loop) < max(2.0 * row, 0.12 * loop):
            continue
        folded = [abs(k * f0 - m * adc) for k in (2, 3, 4, 5, 6, 7, 9) for m in range(4)]
        if all(abs(f - f0) > 250.0 for f in folded):
            return row, window, decimation


def draw_unit(kind: str, rng: np.random.Generator, name: str) -> Unit:
    """Draw a healthy unit of a kind, ``ring`` or ``hrg``."""
    ring = kind == "ring"
    f0 = (15000.0 if ring else 5000.0) * (1.0 + rng.normal(0, 7e-4))
    q = (30000.0 if ring else 2e5) * (1.0 + rng.normal(0, 0.04))
    w0 = TWO_PI * f0
    tau_inv = w0 / (2.0 * q)
    row, window, decimation = _clocks(rng, ring, f0)
    adc = row * window * decimation

    def around(scale: float) -> float:
        return float(rng.normal(0, scale))

    def turn(size: float) -> tuple[float, float]:
        a = rng.uniform(0, TWO_PI)
        return float(size * math.cos(a)), float(size * math.sin(a))

    delta, coupling, rotation = around(0.008 if ring else 0.02), around(0.002), around(0.004 if ring else 0.01)
    drive = np.array([[1.0 - delta / 2, coupling - rotation], [coupling + rotation, 1.0 + delta / 2]]) * (1.0 + around(0.01))
    pick = np.array([[1.0, around(5e-4)], [around(5e-4), 1.0 + around(0.01)]]) * (1.0 + around(0.01))
    feed = 1e-3 if ring else 2.5e-4
    size = np.array([[1.0, 0.25], [0.25, 1.0]]) * feed
    pick_lag, drive_lag = rng.uniform(0.01, 0.04), rng.uniform(0.005, 0.03)
    rebalance = min(rng.uniform(25.0, 60.0), 0.2 * row)
    return Unit(
        kind=kind,
        name=name,
        f0=f0,
        q=q,
        kappa=float(0.8 + around(1e-3) if ring else 0.55 + around(2e-3)),
        gain=float((8.3 if ring else 0.20) * (1.0 + around(0.05))),
        split=turn(TWO_PI * (rng.uniform(0.06, 0.25) if ring else rng.uniform(8e-4, 4e-3))),
        damping_split=turn(tau_inv * rng.uniform(1.5e-3, 1e-2)),
        drive=drive,
        pick=pick,
        drive_pole=w0 / np.tan(drive_lag + rng.uniform(-2e-3, 2e-3, 2)),
        pick_pole=w0 / np.tan(pick_lag + rng.uniform(-3e-3, 3e-3, 2)),
        feed_direct=rng.normal(0, 1, (2, 2)) * size * 0.5,
        feed_slow=rng.normal(0, 1, (2, 2)) * size * 0.6,
        rate=float(rng.uniform(-1, 1) * 7.2e-5),
        noise_v=float((1.2e-6 if ring else 1.7e-7) * rng.uniform(0.7, 1.6)),
        noise_w=float((3e-6 if ring else 2.5e-7) * rng.uniform(0.6, 1.8)),
        row_rate=row,
        window=window,
        decimation=decimation,
        substeps=math.ceil(16.0 * f0 / adc),
        row_band=float(rng.uniform(0.28, 0.38)),
        latency=int(rng.integers(0, 2)),
        loops={
            "ENV_HZ": min(450.0, 0.15 * row * decimation),
            "PLL_HZ": float(min(rng.uniform(15.0, 30.0), 0.12 * row)),
            "AGC_HZ": float(min(rng.uniform(8.0, 16.0), 0.1 * row)) if ring else float(rng.uniform(4.0, 8.0)),
            "REB_HZ": float(rebalance if ring else min(rng.uniform(10.0, 20.0), 0.12 * row)),
            "QUAD_HZ": float(rng.uniform(4.0, 9.0)),
        },
        tc={
            "frequency": float((-27e-6 if ring else 85e-6) * (1.0 + around(0.03))),
            "damping": float((2.0e-3 if ring else 1.0e-3) * (1.0 + around(0.3))),
            "gain_drive": around(6e-5),
            "gain_pick": around(6e-5),
            "gain_drive_difference": around(6e-6),
            "gain_pick_difference": around(6e-6),
            "phase": around(3e-6),
        },
        wander={
            "temperature": float(rng.uniform(1e-3, 2.5e-3)),
            "temperature_s": float(rng.uniform(30.0, 90.0)),
            "gain": float(rng.uniform(0.5e-6, 2e-6)),
        },
        thermometer={"lag": float(rng.uniform(0.05, 0.4)), "noise": float(rng.uniform(3e-4, 2e-3)), "step": 1e-4},
        heater_lag=float(rng.uniform(0.2, 0.8)),
        table={"late": float(rng.uniform(0.0, 1.5e-3)), "ramp": float(rng.uniform(0.012, 0.03))},
        body=(float(2.0 * (8.0 if ring else 0.2) * rng.uniform(0.8, 1.2)), float(rng.uniform(-0.3, 0.3))),
    )
