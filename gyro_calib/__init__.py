"""Calibrate, simulate and explain a Coriolis vibratory gyroscope, without turning it.

Conventions charter (every module keeps it; nothing below restates it differently)
------------------------------------------------------------------------------------
Measurement model, written once:  ``omega_meas = K * omega + b + n`` with ``K`` the scale factor (dimensionless when
``omega_meas`` is in rad/s), ``b`` the *bias* (never "offset") and ``n`` white noise (angle random walk) plus slower noise.
The calibrated rate is ``(omega_meas - b) / K``.

Units        SI everywhere, unit suffix on names where it is not obvious (``_hz``, ``_rad_s``, ``_v``, ``_degc``); deg/h and ppm
             only where a person reads them (:mod:`gyro_calib.units`).
Envelopes    ``signal(t) = c cos(phi) - s sin(phi) = Re[(c + i s) exp(i phi)]``, ``phi`` the phase reference, ``dphi/dt = omega``.
Resonator    ``z'' + D z' + 2 kappa Omega J z' + K z + N = B v``, ``J = [[0, -1], [1, 0]]``, ``V = P z + E v``.
Slow flow    ``p' = (A - i (omega - omega0)) p + G u``, ``p = V^ - E u`` the pick-off envelope without feedthrough.
Sense axis   +z of the gyro frame; ``Omega > 0`` is counter-clockwise seen from +z (REP 103).
Truth        what a simulated device is (:mod:`gyro_calib.device`); belief is what an estimator says
             (:mod:`gyro_calib.estimation`, :mod:`gyro_calib.calibration`). The two never share a type.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
else:

    def __getattr__(name: str) -> str:
        """``__version__``, read from package.xml (the one place that states it) when first asked for."""
        if name == "__version__":
            from .paths import package_version

            return package_version()
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
