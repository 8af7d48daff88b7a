"""Whole-angle gyros for tests: what a few of them measure in the frame of the wave."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyro_calib.device import Device, load_device
from gyro_calib.estimation.drive_chain import drive_chain_of
from gyro_calib.recording.command import Command, Setpoints
from gyro_calib.recording.rate import wave_azimuth
from gyro_calib.simulation import GyroSimulator


def low_q_hrg(**errors: float) -> Device:
    """The packaged hemisphere at Q 2e5 with only the stated errors of drive (``gain_mismatch``) or resonator (``damping_anisotropy``)."""
    base = load_device("hrg_hardware")
    drive = {"gain_mismatch": 0.0, "two_delta_rad": 0.0, "two_lambda_rad": 0.0}
    resonator = {"quality_factor": 2e5, "frequency_split_hz": 0.0, "damping_anisotropy": 0.0}
    for name, value in errors.items():
        (drive if name in drive else resonator)[name] = value
    return replace(base, drive=replace(base.drive, **drive), resonator=replace(base.resonator, **resonator))


def design_gain(device: Device) -> float:
    """|G| of a perfect unit [1/s per V], the hold of the converter included."""
    hold = np.sinc(device.resonator.frequency_hz / device.electronics.adc_rate_hz)
    return float(hold * device.pickoff.gain_v_per_m * device.drive.gain_m_s2_per_v / (2.0 * device.resonator.omega0_rad_s))


def simulate(device: Device, fidelity: str = "slow_flow", *, noisy: bool = False, seed: int = 1) -> GyroSimulator:
    return GyroSimulator(device, rng=np.random.default_rng(seed), fidelity=fidelity, noisy=noisy)


def whole_angle(mode: str = "whole_angle", **setpoints: float) -> Command:
    return Command(mode, setpoints=Setpoints(**setpoints))


@dataclass(frozen=True)
class Wave:
    """A stretch in the frame of the wave: rows, azimuth theta, precession between rows at ``middle``, drives along and across."""

    rows: NDArray[np.float64]
    theta: NDArray[np.float64]
    rate: NDArray[np.float64]
    middle: NDArray[np.float64]
    along: NDArray[np.complex128]
    across: NDArray[np.complex128]


def in_wave_frame(rows: NDArray[np.float64]) -> Wave:
    theta = wave_azimuth(rows)
    ux, uy = rows[:, 6] + 1j * rows[:, 7], rows[:, 8] + 1j * rows[:, 9]
    c, s = np.cos(2 * theta), np.sin(2 * theta)
    middle = 0.5 * (theta[1:] + theta[:-1])
    return Wave(rows, theta, np.diff(theta) / np.diff(rows[:, 0]), middle, ux * c + uy * s, uy * c - ux * s)


def harmonics(values: NDArray[np.float64], theta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean, cos 4 theta, sin 4 theta of values over azimuth, by least squares, shape (3,)."""
    design = np.column_stack([np.ones_like(theta), np.cos(4 * theta), np.sin(4 * theta)])
    return np.asarray(np.linalg.lstsq(design, values, rcond=None)[0])


def amplitude(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt((rows[:, 2:6] ** 2).sum(axis=1)))


#: the errors of document 004's hardware (its section 5.2) but for the split and damping axes of the packaged device
HARDWARE_ERRORS = {
    "gain_mismatch": -0.027,
    "two_delta_rad": 3.6e-3,
    "two_lambda_rad": -0.022,
    "damping_anisotropy": 0.002,
    "frequency_split_hz": 3.1e-3,
}


def unbalanced_hrg(**changes: float) -> Device:
    """A hemisphere at Q 2e5 whose unbalanced forcers make a bias of some 660 deg/h: quick to calibrate, much to gain."""
    device = low_q_hrg(**{**HARDWARE_ERRORS, **changes})
    return replace(device, device_id="hrg_low_q")


def left_behind(device: Device, compensation: tuple[float, ...] = (1.0, 0.0, 0.0, 1.0)) -> np.ndarray:
    """True dG, 2 delta, 2 lambda behind a compensation, over the true pattern of the damping: from the device itself."""
    flow = device.slow_flow()
    pattern = flow.A.real / flow.A[0, 0].real
    chain = drive_chain_of(flow.G @ np.reshape(compensation, (2, 2)) @ np.linalg.inv(0.5 * (pattern + pattern.T)))
    return np.array([chain.delta_g, chain.two_delta, chain.two_lambda])
