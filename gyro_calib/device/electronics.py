"""Converters, sampling, loops, noise and surroundings of a device."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import DeviceError
from .checks import require_finite, require_non_negative, require_positive

__all__ = ["SLOTS", "Electronics", "Environment", "Loops", "Multiplexing", "Noise"]

#: control periods in a frame of single-channel electronics: read x, drive x, read y, drive y
SLOTS = 4


@dataclass(frozen=True)
class Electronics:
    """Sampling and converters.

    Parameters
    ----------
    adc_rate_hz : float
        Converter rate; 12 or more samples per carrier cycle.
    samples_per_control : int
        Converter samples per control step (a multiple that spans whole half cycles of the carrier is best).
    controls_per_row : int
        Control steps per recorded row.
    adc_full_scale_v, dac_full_scale_v : float
        Converters clip here.
    adc_bits, dac_bits : int
        0 = ideal, no quantisation.
    """

    adc_rate_hz: float
    samples_per_control: int = 24
    controls_per_row: int = 20
    adc_full_scale_v: float = 2.5
    dac_full_scale_v: float = 5.0
    adc_bits: int = 0
    dac_bits: int = 0

    def __post_init__(self) -> None:
        require_finite(self)
        require_positive(self, "adc_rate_hz", "samples_per_control", "controls_per_row", "adc_full_scale_v", "dac_full_scale_v")
        require_non_negative(self, "adc_bits", "dac_bits")

    @property
    def control_rate_hz(self) -> float:
        """Control steps per second [Hz]."""
        return self.adc_rate_hz / self.samples_per_control

    @property
    def sample_rate_hz(self) -> float:
        """Recorded rows per second [Hz]."""
        return self.control_rate_hz / self.controls_per_row


@dataclass(frozen=True)
class Multiplexing:
    """Single-channel electronics: one read and one drive chain, switched in time between the axes (document 004 section 2.2).

    A frame of four slots, one control period each: read x, drive x, read y, drive y. Between its readings a pick-off is held; a drive is on
    in its slot only, with the volts that give the commanded mean. The loops run once in a frame, after y was read. Nothing is driven while
    anything is read, so there is no feedthrough.

    Parameters
    ----------
    enabled : bool
        False: dual-channel electronics, everything at once.
    settling_share : float
        Share of each slot, at its start, in which the switched chain settles and is not used. The rest had better span whole half cycles
        of the carrier, or the drive turns in phase by up to the inverse of its angle.
    delay_s : float
        Delay of the read chain that the demodulator does not know: both pick-offs lag by omega times this.
    crosstalk : float
        Share of the other axis' voltage that is left on the read chain.
    """

    enabled: bool = False
    settling_share: float = 0.2
    delay_s: float = 0.0
    crosstalk: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)
        require_non_negative(self, "settling_share", "delay_s")
        if self.settling_share > 0.9:
            raise DeviceError(f"Multiplexing settling_share must be at most 0.9, but got {self.settling_share!r}.")

    @property
    def drive_share(self) -> float:
        """Share of the time that a drive is on: of the converter's range, what a commanded mean may have."""
        return (1.0 - self.settling_share) / SLOTS if self.enabled else 1.0


@dataclass(frozen=True)
class Loops:
    """Closed-loop bandwidths [Hz].

    Parameters
    ----------
    pll_bandwidth_hz, amplitude_bandwidth_hz : float
        Of every closed mode.
    rebalance_bandwidth_hz : float
        Both quadratures of the closed axis, force to rebalance.
    quadrature_bandwidth_hz : float
        Quadrature loop, whole angle.
    ring_threshold : float
        Amplitude over its set point at which a ring-down ends (document 003: one half).
    """

    pll_bandwidth_hz: float = 20.0
    amplitude_bandwidth_hz: float = 10.0
    rebalance_bandwidth_hz: float = 100.0
    quadrature_bandwidth_hz: float = 20.0
    ring_threshold: float = 0.5

    def __post_init__(self) -> None:
        require_finite(self)
        require_positive(self, "pll_bandwidth_hz", "amplitude_bandwidth_hz", "rebalance_bandwidth_hz", "quadrature_bandwidth_hz")
        if not 0.25 <= self.ring_threshold < 1.0:
            raise DeviceError(f"Loops ring_threshold must be within 0.25 and 1, but got {self.ring_threshold!r}.")


@dataclass(frozen=True)
class Noise:
    """White and flicker noise of the electronics; the thermomechanical noise follows from the resonator.

    Parameters
    ----------
    pickoff_v_rthz : float
        Pick-off noise, one-sided amplitude density [V/sqrt(Hz)].
    drive_v_rthz : float
        Drive noise, one-sided amplitude density [V/sqrt(Hz)].
    thermomechanical : bool
        Include the Brownian force.
    drive_flicker_v : float
        Flicker of what reaches the electrodes besides the command (pick-up of the reference, slow phase and gain errors): floor of the
        Allan deviation of each quadrature of each channel [V]. Not in the drive columns. Sets the bias instability.
    """

    pickoff_v_rthz: float = 0.0
    drive_v_rthz: float = 0.0
    thermomechanical: bool = True
    drive_flicker_v: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)
        require_non_negative(self, "pickoff_v_rthz", "drive_v_rthz", "drive_flicker_v")


@dataclass(frozen=True)
class Environment:
    """Temperature of the resonator over time.

    Parameters
    ----------
    temperature_degc : float
        Mean temperature.
    ramp_k_per_s : float
        Steady drift.
    wander_k, wander_time_s : float
        Standard deviation and correlation time of an Ornstein-Uhlenbeck wander.
    """

    temperature_degc: float = 25.0
    ramp_k_per_s: float = 0.0
    wander_k: float = 0.0
    wander_time_s: float = 60.0

    def __post_init__(self) -> None:
        require_finite(self)
        require_non_negative(self, "wander_k")
        require_positive(self, "wander_time_s")
        if not -273.15 < self.temperature_degc < 1000.0:
            raise DeviceError(f"Environment temperature_degc must be within -273.15 and 1000, but got {self.temperature_degc!r}.")
