"""Raw carrier-rate samples to the recording contract: own digital PLL, I/Q demodulation, one filter (document 000, step "data table").

Every channel is multiplied by ``2 e^{-i phi}`` of the phase reference and passed through the same symmetric cascade of boxcars, the
reference's own frequency too, so that a row's envelopes and its frequency are means over the same instants (theory.md section 2: half a row
of delay in omega costs 28 deg/h). A raw drive sample is what the converter holds from then on: its waveform is centred half a sample later.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from .columns import COLUMNS
from .decimation import RowGrid, decimate
from .phase_lock import LEAST_SAMPLES_PER_CYCLE, carrier_frequency, is_phase, lock_phase
from .raw_block import SIGNALS, RawBlock, finite_number
from .recording import Recording

__all__ = ["demodulate", "reference_phase"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: rows per second when nobody says otherwise [Hz]
ROW_RATE_HZ = 500.0


def demodulate(
    recording: Recording,
    *,
    row_rate_hz: float | None = None,
    order: int = 3,
    reference: str = "auto",
    bandwidth_hz: float = 200.0,
    factory: Mapping[str, Any] | None = None,
) -> Recording:
    """Demodulate the raw block of a recording.

    Parameters
    ----------
    recording : Recording
        ``raw`` holds ``t`` [s], ``x_pick``, ``y_pick``, ``x_drive``, ``y_drive`` [V] at one rate and ``phase_ref``: a reference voltage
        ``cos phi`` (with harmonics, noise, amplitude modulation) or phi itself [rad], which is told apart. Rows that it holds besides give
        the row rate, the times of the rows and the temperature.
    row_rate_hz : float, optional
        Rows per second (rounded to a whole decimation); default: that of the rows, or 500.
    order : int
        Boxcars in the filter.
    reference : {"auto", "phase_ref", "x_pick", "y_pick", "x_drive", "y_drive"}
        Channel that gives the phase; ``"auto"``: ``phase_ref`` or, without one, the driven channel with loops off, else the oscillator's
        pick-off (as in document 000), the stronger one when no axis is the oscillator.
    bandwidth_hz : float
        Of the phase lock on a voltage.
    factory : mapping, optional
        ``nominal_f0_hz`` (where to look for the carrier), ``reference_temperature_degC`` (when nothing states the temperature),
        ``dac_zero_order_hold_s`` (when the recording does not state it).

    Returns
    -------
    Recording
        Rows of the contract without the raw block; ``extras["demodulation"]`` says how they were made. In a force-rebalance mode a
        reference that is a sine, or inverted, is turned by whole quarters so that the oscillator's pick-off is its cosine.

    Raises
    ------
    DataError
        A channel is missing, not finite or off its time grid; sampling too slow; no carrier; too short; a wrong ``reference``.
    """
    raw = RawBlock.of(recording)
    factory = factory or {}
    if "dac_zero_order_hold_s" not in recording.extras and "dac_zero_order_hold_s" in factory:
        recording = replace(recording, extras={**recording.extras, "dac_zero_order_hold_s": factory["dac_zero_order_hold_s"]})
    nominal = finite_number(factory.get("nominal_f0_hz"))
    phase, margin, source = _reference(raw, recording, reference, nominal, bandwidth_hz)
    rate = row_rate_hz or (recording.sample_rate_hz if recording.sample_rate_hz < 0.5 * raw.rate_hz else ROW_RATE_HZ)
    if not 0.0 < rate <= 0.5 * raw.rate_hz or order < 1:
        raise DataError(f"Row rate must be > 0 and at most {0.5 * raw.rate_hz:g} Hz with order >= 1, but got {rate!r}, {order!r}.")
    decimation = round(raw.rate_hz / rate)
    centre = None
    if len(recording):
        centre = float((recording.t[0] - raw.start_s) * raw.rate_hz)
    grid = RowGrid.within(margin, raw.size - margin, decimation, order, centre)
    if grid.count < 2:
        need = (order * decimation + decimation + 2 * margin) / raw.rate_hz
        raise DataError(f"Raw block{raw.where} must last {need:.3g} s for two rows, but got {raw.size / raw.rate_hz:.3g} s. Record longer.")
    envelopes = _envelopes(raw, phase, grid, recording)
    quarters = _quarter_turns(envelopes, recording.command.oscillator_axis)
    data = np.empty((grid.count, len(COLUMNS)))
    data[:, 0] = raw.start_s + grid.centres / raw.rate_hz
    data[:, 1] = recording.column("segment")[0] if len(recording) else 0.0
    turned = envelopes * 1j ** (-quarters)
    data[:, 2:10:2], data[:, 3:10:2] = turned.real, turned.imag
    data[:, 10] = decimate(np.gradient(phase), grid).real * raw.rate_hz / (2.0 * math.pi)
    data[:, 11] = raw.temperature(recording, grid, data[:, 0], factory)
    how = {
        "reference": source,
        "adc_rate_hz": raw.rate_hz,
        "decimation": decimation,
        "order": order,
        "reference_quarter_turns": quarters,
    }
    return replace(
        recording, data=data, sample_rate_hz=raw.rate_hz / decimation, extras={**recording.extras, "demodulation": how}, raw=None
    )


def reference_phase(
    recording: Recording, *, reference: str = "auto", bandwidth_hz: float = 200.0, factory: Mapping[str, Any] | None = None
) -> tuple[FloatArray, slice]:
    """Phase at every raw sample [rad], and the samples where it is sound; arguments and errors as :func:`demodulate`."""
    raw = RawBlock.of(recording)
    phase, margin, _ = _reference(raw, recording, reference, finite_number((factory or {}).get("nominal_f0_hz")), bandwidth_hz)
    return phase, slice(margin, raw.size - margin)


def _reference(
    raw: RawBlock, recording: Recording, wanted: str, nominal_hz: float | None, bandwidth_hz: float
) -> tuple[FloatArray, int, str]:
    """Phase at every sample, samples to leave out at each end, and what it was taken from."""
    name = wanted
    if wanted == "auto":
        name = "phase_ref" if "phase_ref" in raw.channels else _stand_in(raw, recording)
    if name not in ("phase_ref", *SIGNALS):
        raise DataError(f"Argument reference must be 'auto', 'phase_ref' or one of {', '.join(SIGNALS)}, but got {wanted!r}.")
    if name not in raw.channels:
        raise DataError(f"Raw block{raw.where} must hold the reference {name}, but does not. Use reference='auto' to lock to the pick-off.")
    signal = raw.channels[name]
    if name == "phase_ref" and is_phase(signal):
        phase = np.unwrap(signal)
        # a phase that falls is the same cosine
        phase = phase if phase[-1] > phase[0] else -phase
        cycle = 2.0 * math.pi * (phase.size - 1) / float(phase[-1] - phase[0])
        if cycle < LEAST_SAMPLES_PER_CYCLE:
            raise DataError(
                f"Converter rate{raw.where} must be at least {LEAST_SAMPLES_PER_CYCLE:g} samples per carrier cycle, but got {cycle:.3g}. "
                "Sample faster."
            )
        carrier_frequency(raw.channels[_stand_in(raw, recording)], raw.rate_hz, raw.rate_hz / cycle, what=_stand_in(raw, recording))
        return phase, 0, "phase_ref [rad]"
    near = recording.command.excitation.frequency_hz if recording.command.mode == "loops_off" else nominal_hz
    if len(recording):
        near = float(np.median(recording.column("ref_freq")))
    phase, margin = lock_phase(signal, raw.rate_hz, near_hz=near or None, bandwidth_hz=bandwidth_hz, what=f"{name}{raw.where}")
    return phase, margin, f"{name} [V]"


def _stand_in(raw: RawBlock, recording: Recording) -> str:
    """Channel that carries the phase when no reference was recorded."""
    command = recording.command
    if command.oscillator_axis:
        return f"{command.oscillator_axis}_pick"
    if command.mode == "loops_off" and command.excitation.kind == "drive" and command.excitation.axis in ("x", "y"):
        return f"{command.excitation.axis}_drive"
    return "x_pick" if np.ptp(raw.channels["x_pick"]) >= np.ptp(raw.channels["y_pick"]) else "y_pick"


def _envelopes(raw: RawBlock, phase: FloatArray, grid: RowGrid, recording: Recording) -> ComplexArray:
    """Envelopes of x and y pick-off, x and y drive, shape (rows, 4)."""
    carrier = np.exp(-1j * phase)
    step = (phase[-1] - phase[0]) / (phase.size - 1)
    columns = []
    for name in SIGNALS:
        envelope = decimate(2.0 * raw.channels[name] * carrier, grid)
        columns.append(envelope * _held(step, raw.rate_hz, recording.extras) if name.endswith("drive") else envelope)
    return np.column_stack(columns).astype(np.complex128)


def _held(step_rad: float, rate_hz: float, extras: Mapping[str, Any]) -> complex:
    """From the samples of a held drive to the commanded drive envelope, which is what the columns hold.

    The converter holds for h = k samples. Sampled k times, the staircase is down by the Dirichlet kernel D_k and late by (k - 1)/2 samples;
    the waveform itself is centred h/2 after its start, and the firmware has advanced the command for that: by the stated phase, else by
    just omega h/2. Without ``dac_zero_order_hold_s`` the samples are taken for those of a smooth voltage.
    """
    hold = finite_number(extras.get("dac_zero_order_hold_s")) or 0.0
    advance = finite_number(extras.get("firmware_drive_phase_advance_rad"))
    if hold <= 0.0:
        return np.exp(-1j * (advance or 0.0))
    k = max(1, round(hold * rate_hz))
    droop = math.sin(0.5 * k * step_rad) / (k * math.sin(0.5 * step_rad))
    late = 0.5 * (k - 1) * step_rad
    if advance is None:
        advance = 0.5 * k * step_rad
    return complex(np.exp(1j * (late - advance)) / droop)


def _quarter_turns(envelopes: ComplexArray, oscillator: str | None) -> int:
    """Quarter turns that the oscillator's pick-off leads the cosine of the reference by (0 when no axis is the oscillator)."""
    if oscillator is None:
        return 0
    return round(float(np.angle(envelopes[:, "xy".index(oscillator)].mean())) / (0.5 * math.pi)) % 4
