"""What a gyro can be told to do: mode, excitation, set points, drive compensation. The same words live and in files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import DataError

__all__ = ["EXCITATIONS", "MODES", "Command", "Excitation", "Setpoints", "excitation_kind"]

#: operating modes
MODES = ("ftr_x", "ftr_y", "whole_angle", "ring_down", "ring_up", "stiffness", "loops_off")
#: kinds of excitation, f = ``frequency_hz``. ``amplitude_modulation``: oscillator position set to amplitude (1 + index sin 2 pi f t);
#: ``frequency_modulation``: phase of the oscillator against the reference set to index sin 2 pi f t [rad];
#: ``secondary_modulation``: the closed axis is driven to amplitude * index * sin 2 pi f t; ``drive`` (loops_off): open drive of ``axis``
#: at absolute f with ``volts``; ``body`` (loops_off): the body is shaken at absolute f, equal force on both axes.
EXCITATIONS = ("none", "amplitude_modulation", "frequency_modulation", "secondary_modulation", "drive", "body")


def excitation_kind(stated: object) -> str:
    """One of :data:`EXCITATIONS`, however it was worded: "amplitude modulation", "open drive", "shaker", "off".

    Raises
    ------
    DataError
        Words that leave open what was excited.
    """
    words = str(stated).lower().replace("-", " ").replace("_", " ").strip()
    exact = words.replace(" ", "_")
    if exact in EXCITATIONS:
        return exact
    for kind in ("secondary", "frequency", "amplitude"):
        if kind in words and "modulat" in words:
            return f"{kind}_modulation"
    for kind, known in (("none", ("", "off", "no")), ("drive", ("open drive",)), ("body", ("body excitation", "shaker"))):
        if words in known:
            return kind
    raise DataError(f"Excitation kind must be one of {', '.join(EXCITATIONS)}, but got {stated!r}. State what was modulated.")


@dataclass(frozen=True)
class Excitation:
    """A known disturbance.

    Parameters
    ----------
    kind : str
        One of :data:`EXCITATIONS`.
    frequency_hz : float
        Side-band frequency of a modulation, or absolute frequency of ``drive`` and ``body`` [Hz].
    index : float
        Modulation index, dimensionless.
    volts : float
        Amplitude of ``drive`` or ``body`` [V].
    axis : str
        ``"x"`` or ``"y"`` (``drive``), ``"both"`` (``body``), ignored by modulations of the oscillator.

    Raises
    ------
    DataError
        Unknown kind or axis, a number that is not finite, or a negative frequency.
    """

    kind: str = "none"
    frequency_hz: float = 0.0
    index: float = 0.0
    volts: float = 0.0
    axis: str = "x"

    def __post_init__(self) -> None:
        if self.kind not in EXCITATIONS:
            raise DataError(f"Excitation kind must be one of {', '.join(EXCITATIONS)}, but got {self.kind!r}.")
        if self.axis not in ("x", "y", "both"):
            raise DataError(f"Excitation axis must be 'x', 'y' or 'both', but got {self.axis!r}.")
        for name in ("frequency_hz", "index", "volts"):
            value = getattr(self, name)
            if not math.isfinite(value):
                raise DataError(f"Excitation {name} must be finite, but got {value!r}.")
        if self.frequency_hz < 0.0:
            raise DataError(f"Excitation frequency_hz must be >= 0, but got {self.frequency_hz!r}.")


@dataclass(frozen=True)
class Setpoints:
    """Set points of the loops.

    Parameters
    ----------
    amplitude_v : float
        Pick-off amplitude of the oscillator or of the wave [V].
    virtual_precession_v : float
        Constant precession drive of a whole-angle gyro, along u_perp_s of theory Eq. 6 [V].
    stiffness_v_per_v : float
        CR: drive added per pick-off volt, in phase with displacement [V/V].
    amplitude_gain_v_per_v : float
        CA of ring-down/up: drive in phase with velocity per pick-off volt [V/V], negative drives down.
    rebalance : float
        1: the closed axis of a force-rebalance mode is held by its drive; 0: its drive is off (open secondary, document 000).
    """

    amplitude_v: float = 1.0
    virtual_precession_v: float = 0.0
    stiffness_v_per_v: float = 0.0
    amplitude_gain_v_per_v: float = 0.0
    rebalance: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value):
                raise DataError(f"Set point {name} must be finite, but got {value!r}.")
        if self.amplitude_v <= 0.0:
            raise DataError(f"Set point amplitude_v must be > 0, but got {self.amplitude_v!r}.")
        if self.rebalance not in (0.0, 1.0):
            raise DataError(f"Set point rebalance must be 1 (on) or 0 (off), but got {self.rebalance!r}.")


@dataclass(frozen=True)
class Command:
    """One complete command; it takes effect atomically and starts a new segment.

    Parameters
    ----------
    mode : str
        One of :data:`MODES`. ``ftr_x``: x is the oscillator, y is held at zero.
    excitation : Excitation
        Known disturbance.
    setpoints : Setpoints
        Set points of the loops.
    compensation : tuple of 4 float
        2x2 drive compensation matrix, row-major, applied to (u_x, u_y) before the drive columns are recorded.
    """

    mode: str = "ftr_x"
    excitation: Excitation = field(default_factory=Excitation)
    setpoints: Setpoints = field(default_factory=Setpoints)
    compensation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise DataError(f"Mode must be one of {', '.join(MODES)}, but got {self.mode!r}.")
        if len(self.compensation) != 4 or not all(math.isfinite(c) for c in self.compensation):
            raise DataError(f"Compensation must be 4 finite numbers (2x2, row-major), but got {self.compensation!r}.")

    @property
    def oscillator_axis(self) -> str | None:
        """``"x"`` or ``"y"`` in force-to-rebalance modes, else ``None``."""
        return {"ftr_x": "x", "ftr_y": "y"}.get(self.mode)

    def to_parameters(self) -> dict[str, Any]:
        """Flat ROS parameter names and values (``mode``, ``excitation.*``, ``setpoint.*``, ``compensation``)."""
        flat: dict[str, Any] = {"mode": self.mode}
        flat |= {f"excitation.{k}": v for k, v in vars(self.excitation).items()}
        flat |= {f"setpoint.{k}": v for k, v in vars(self.setpoints).items()}
        flat["compensation"] = list(self.compensation)
        return flat

    @classmethod
    def from_parameters(cls, flat: Mapping[str, Any]) -> Command:
        """Inverse of :meth:`to_parameters`; missing names take their defaults.

        Raises
        ------
        DataError
            An unknown name under ``excitation.`` or ``setpoint.``, or a value out of range.
        """
        excitation = {k.split(".", 1)[1]: v for k, v in flat.items() if k.startswith("excitation.")}
        setpoints = {k.split(".", 1)[1]: v for k, v in flat.items() if k.startswith("setpoint.")}
        if "kind" in excitation:
            excitation["kind"] = excitation_kind(excitation["kind"])
        if flat.get("mode") == "loops_off" and setpoints.get("amplitude_v") == 0.0:
            # no loop holds an amplitude then, and some drivers say so
            del setpoints["amplitude_v"]
        try:
            return cls(
                mode=str(flat.get("mode", "ftr_x")),
                excitation=Excitation(**excitation),
                setpoints=Setpoints(**setpoints),
                compensation=tuple(float(c) for c in flat.get("compensation", (1.0, 0.0, 0.0, 1.0))),  # type: ignore[arg-type]
            )
        except (TypeError, ValueError) as error:
            raise DataError(f"Command parameters must be known names with their types, but got {dict(flat)!r} ({error}).") from error
