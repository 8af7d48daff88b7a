"""Draw a unit: the same design with the spread of manufacture. Deterministic in the seed."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import DeviceError
from .chains import Feedthrough
from .device import Device

__all__ = ["SPREADS", "Spread", "draw_unit"]


@dataclass(frozen=True)
class Spread:
    """Standard deviations (or half-widths where said) of what differs from unit to unit.

    Engineering estimates for a silicon ring; angles in rad, mismatches relative.

    Parameters
    ----------
    frequency_hz : float
        Resonance [Hz].
    quality_factor : float
        Relative.
    split_low_hz, split_high_hz : float
        Ends of the range of the frequency split [Hz].
    damping_anisotropy : float
        Relative difference of the two decay rates.
    gain, gain_mismatch : float
        Of drives and pick-offs, relative; of one axis against the other.
    misalignment_rad, pickoff_non_orthogonality_rad, phase_rad, coupling_phase_rad : float
        Angles of drives and pick-offs; electrical phases of the channels and of what couples across [rad].
    feedthrough : float
        Each part of each element of E [1].
    drive_gain_ratio : float
        How far the factory's drive-gain ratio is off, relative.
    """

    frequency_hz: float = 20.0
    quality_factor: float = 0.08
    split_low_hz: float = 0.08
    split_high_hz: float = 0.3
    damping_anisotropy: float = 0.01
    gain: float = 0.03
    gain_mismatch: float = 0.01
    misalignment_rad: float = 3e-3
    pickoff_non_orthogonality_rad: float = 1e-3
    phase_rad: float = 3e-3
    coupling_phase_rad: float = 0.1
    feedthrough: float = 4e-4
    drive_gain_ratio: float = 15e-6


#: spread by kind of resonator, where it is not that of a silicon ring
SPREADS: dict[str, Spread] = {
    "hrg": Spread(
        frequency_hz=5.0,
        quality_factor=0.05,
        split_low_hz=1e-3,
        split_high_hz=6e-3,
        damping_anisotropy=1e-3,
        gain_mismatch=5e-3,
        misalignment_rad=2e-3,
        phase_rad=2e-4,
        coupling_phase_rad=0.02,
        feedthrough=2e-5,
    )
}


def draw_unit(design: Device, seed: int, spread: Spread | None = None) -> Device:
    """Return one unit of a design.

    Parameters
    ----------
    design : Device
        The design; its own imperfections are the means.
    seed : int
        Same seed, same unit; the unit is named ``<design>-<seed, 4 digits>``.
    spread : Spread, optional
        How much units differ (default: as usual for the kind of resonator, :data:`SPREADS`).

    Returns
    -------
    Device
        The unit, with the drive-gain ratio that a factory measured on it.

    Raises
    ------
    DeviceError
        Negative seed.
    """
    if seed < 0:
        raise DeviceError(f"Argument seed must be >= 0, but got {seed!r}.")
    s = spread or SPREADS.get(design.factory_data.kind, Spread())
    rng = np.random.default_rng([0x6797, seed])
    n = rng.standard_normal
    resonator = replace(
        design.resonator,
        frequency_hz=design.resonator.frequency_hz + s.frequency_hz * n(),
        quality_factor=design.resonator.quality_factor * math.exp(s.quality_factor * n()),
        frequency_split_hz=rng.uniform(s.split_low_hz, s.split_high_hz),
        split_azimuth_rad=rng.uniform(0.0, math.pi / 2),
        damping_anisotropy=abs(design.resonator.damping_anisotropy + s.damping_anisotropy * n()),
        damping_azimuth_rad=rng.uniform(0.0, math.pi / 2),
    )
    drive = replace(
        design.drive,
        gain_m_s2_per_v=design.drive.gain_m_s2_per_v * (1.0 + s.gain * n()),
        gain_mismatch=design.drive.gain_mismatch + s.gain_mismatch * n(),
        two_delta_rad=design.drive.two_delta_rad + s.misalignment_rad * n(),
        two_lambda_rad=design.drive.two_lambda_rad + s.misalignment_rad * n(),
        phase_x_rad=s.phase_rad * n(),
        phase_y_rad=s.phase_rad * n(),
        coupling_phase_xy_rad=s.coupling_phase_rad * n(),
        coupling_phase_yx_rad=s.coupling_phase_rad * n(),
    )
    pickoff = replace(
        design.pickoff,
        gain_v_per_m=design.pickoff.gain_v_per_m * (1.0 + s.gain * n()),
        gain_mismatch=design.pickoff.gain_mismatch + s.gain_mismatch * n(),
        non_orthogonality_rad=design.pickoff.non_orthogonality_rad + s.pickoff_non_orthogonality_rad * n(),
        phase_x_rad=s.phase_rad * n(),
        phase_y_rad=s.phase_rad * n(),
    )
    direct, cross = s.feedthrough, 0.3 * s.feedthrough
    feedthrough = Feedthrough(direct * n(), direct * n(), cross * n(), cross * n(), cross * n(), cross * n(), direct * n(), direct * n())
    ratio = (1.0 + s.drive_gain_ratio * n()) / (1.0 + drive.gain_mismatch)
    return replace(
        design,
        device_id=f"{design.device_id}-{seed:04d}",
        resonator=resonator,
        drive=drive,
        pickoff=pickoff,
        feedthrough=feedthrough,
        factory_data=replace(design.factory_data, drive_gain_ratio_x_over_y=ratio),
    )
