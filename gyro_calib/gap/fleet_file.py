"""The file in which a fleet says how large the coefficients of its healthy units are: YAML, written by `gyro-calib fleet` or by hand."""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DataError
from ..plain_yaml import load_yaml
from .fleet import FleetSize, fleet_spread
from .healthy import HealthySpread
from .patch import ONE_KIND

__all__ = ["Fleet", "read_fleet", "write_fleet"]

_HEAD = """\
# Healthy units of one kind of gyro: standard deviations, about zero, of what no one calls a gap (SI). For gyro-calib diagnose --fleet.
# Each is the bound that nineteen of twenty fleets keep; behind it what is likeliest, and what is believed of any device.
# What is left out is as of any device.
"""


@dataclass(frozen=True)
class Fleet:
    """Units of one kind, and what is known of them.

    Parameters
    ----------
    nominal_f0_hz : float
        Nominal frequency of the kind [Hz].
    healthy : HealthySpread
    units : tuple of str
        Identities of those that tell it; empty where it was written by hand.
    name, sha256 : str
        Of the file that it was read from; empty where it was not.

    Raises
    ------
    DataError
        A frequency that is not positive and finite.
    """

    nominal_f0_hz: float
    healthy: HealthySpread
    units: tuple[str, ...] = ()
    name: str = ""
    sha256: str = ""

    def __post_init__(self) -> None:
        f0 = self.nominal_f0_hz
        if isinstance(f0, bool) or not isinstance(f0, int | float) or not (math.isfinite(f0) and f0 > 0.0):
            raise DataError(f"Fleet must have a nominal_f0_hz > 0, but got {f0!r}. Give the nominal frequency of its kind of gyro.")

    def check_kind(self, factory: Mapping[str, Any]) -> None:
        """Whether a unit may be one of this fleet.

        Raises
        ------
        DataError
            Its nominal frequency is that of another kind of gyro.
        """
        stated = factory.get("nominal_f0_hz")
        if isinstance(stated, int | float) and abs(stated - self.nominal_f0_hz) > ONE_KIND * self.nominal_f0_hz:
            wanted = f"of the kind of its fleet, with a nominal frequency of about {self.nominal_f0_hz:g} Hz"
            raise DataError(f"Device must be {wanted}, but got {stated:g} Hz. Give --fleet the file of this kind, or leave it out.")


def read_fleet(path: Path) -> Fleet:
    """Read a fleet.

    Raises
    ------
    DataError
        Not readable, not YAML, a size that there is not or that is not positive.
    """
    try:
        content = path.read_bytes()
        document = load_yaml(content.decode())
        sizes = document.get("healthy") if isinstance(document, dict) else None
        healthy = HealthySpread.from_mapping({name: _number(size) for name, size in sizes.items()}) if isinstance(sizes, dict) else None
    except (OSError, ValueError, TypeError) as error:
        raise DataError(f"Fleet file {path.name} must be YAML with nominal_f0_hz and healthy, but got: {error}") from error
    if healthy is None:
        raise DataError(f"Fleet file {path.name} must have a part `healthy` of names and sizes, but got none. Make it by gyro-calib fleet.")
    units = document.get("units") or []
    if not isinstance(units, list):
        raise DataError(f"Fleet file {path.name}: units must be a list of identities, but got {units!r}. Leave it out if they have none.")
    nominal_f0_hz = _number(document.get("nominal_f0_hz", math.nan))
    return Fleet(nominal_f0_hz, healthy, tuple(map(str, units)), path.name, hashlib.sha256(content).hexdigest())


def _number(size: Any) -> Any:
    """What people write as 1e-5 is a text to YAML, which wants 1.0e-5."""
    try:
        return float(size) if isinstance(size, str) else size
    except ValueError:
        return size


def write_fleet(path: Path, nominal_f0_hz: float, units: Sequence[str], sizes: Sequence[FleetSize]) -> Fleet:
    """Write what units of one kind tell, and return it.

    Parameters
    ----------
    path : Path
    nominal_f0_hz : float
    units : sequence of str
        Their identities.
    sizes : sequence of FleetSize
        Those that say more than what is believed of any device are written.

    Raises
    ------
    DataError
        The file cannot be written, or nothing is told.
    """
    told = [size for size in sizes if size.is_told]
    if not told:
        said = f"Fleet must tell a coefficient, but {len(units)} units say nothing of any"
        raise DataError(f"{said}. Warm them by 10 K in one recording each.")
    lines = [f"nominal_f0_hz: {nominal_f0_hz!r}", "units:", *(f"- {name!r}" for name in units), "healthy:"]
    lines += [f"  {s.name}: {s.bound:.2e}  # likeliest {s.likeliest:.2g}, any device {s.usual:.3g}" for s in told]
    partial = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(_HEAD + "\n".join(lines) + "\n", encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise DataError(f"Fleet file must be writable, but got {error}. Choose another path.") from error
    return Fleet(nominal_f0_hz, fleet_spread(told), tuple(units))
