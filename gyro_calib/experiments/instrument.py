"""The one seam between experiments and a gyro: simulated in process, live over ROS, or replayed from a file."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from ..recording.command import Command
from ..recording.recording import Recording

__all__ = ["Instrument", "compensation_in_force"]


@runtime_checkable
class Instrument(Protocol):
    """A gyro that takes commands and gives recordings.

    Attributes
    ----------
    device_id : str
        Identity of the unit; every recording carries it.
    factory : dict
        What left the factory with the unit (``angular_gain_kappa``, ``nominal_f0_hz``, ``nominal_q``, ``drive_gain_ratio_x_over_y``,
        ``nominal_scale_factor_v_per_rad_s`` {x, y}, ``reference_temperature_degC``, full scales).

    Notes
    -----
    An instrument may have ``abilities``, a set of ``"applied_rate"``, ``"raw"`` and ``"temperature"``; its ``record`` then takes
    ``applied_rate`` (how a table turns it during the recording), ``raw_s`` (seconds of converter samples to keep) and ``temperature_degc``
    (where a chamber takes it while it settles, and keeps it; with ``temperature_ramp_s`` in the first so many seconds of the record) by
    keyword. Without the attribute it has none.
    It may say what it was last commanded in ``command``; :func:`compensation_in_force` asks that.
    """

    @property
    def device_id(self) -> str:
        """Identity of the unit."""
        ...

    @property
    def factory(self) -> dict[str, object]:
        """What left the factory with the unit."""
        ...

    def configure(self, command: Command) -> None:
        """Put ``command`` in force; returns when the device has taken it."""

    def record(self, duration_s: float, *, settle_s: float = 0.0, label: str = "") -> Recording:
        """Record ``duration_s`` after ``settle_s`` counted from the last command, under the name ``label``.

        Raises
        ------
        DataError
            The stream has a gap, a repeat or a NaN.
        ExperimentAborted
            The stream stopped, or the run was cancelled.
        """


def compensation_in_force(instrument: Instrument) -> tuple[float, float, float, float]:
    """Drive compensation of an instrument, row-major; the identity of one that does not say its ``command``."""
    command = getattr(instrument, "command", None)
    return command.compensation if isinstance(command, Command) else Command().compensation
