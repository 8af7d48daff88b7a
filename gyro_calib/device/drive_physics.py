"""The drive chain of a hemispherical resonator from first principles (document 004, Eqs. 6-21).

A flat electrode faces the lip of the shell. Tilt of the assembly makes its gap uneven, eccentricity turns the electrodes against the modes,
the resistance of the metal film lowers the bias where leakage flows, and the circuits differ in gain and leak into each other. Together
they are the matrix of :class:`~gyro_calib.device.DriveChain`:
``G [[1, tan 2delta - tan 2lambda], [tan 2delta + tan 2lambda, 1 + Delta G]]``.

The document evaluates the gap at the middle of an electrode and drops products of small quantities (:func:`first_order_unbalance`); the
matrix of :func:`drive_matrix` integrates over the electrode and drops nothing but the feedback of the motion on the force. They differ to
first order too: across an electrode of finite span the force is smaller by ``sin(span) / span``, and a tilt moves its centre, as if turning
the electrode by ``span^2 sigma R sin(beta - beta_sigma) / (6 d)``: 2 lambda gains the sum over the two channels, 2 delta their difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DeviceError
from .chains import DriveChain
from .checks import require_finite, require_non_negative, require_positive

__all__ = [
    "Assembly",
    "DriveCircuit",
    "ElectrodeGeometry",
    "Unbalance",
    "capacitance",
    "capacitance_slope",
    "drive_chain",
    "drive_matrix",
    "first_order_unbalance",
    "unbalance_of",
]

FloatArray = NDArray[np.float64]
#: 1 / (4 pi k) with the Coulomb constant k of document 004 [F/m]
VACUUM_PERMITTIVITY = 8.8541878e-12
#: centres of the electrodes of channels X and Y [rad], 90 and 135 degrees as in document 004: there attraction is a positive force
X_AZIMUTH_RAD, Y_AZIMUTH_RAD = 0.5 * math.pi, 0.75 * math.pi
_NODES = 24


@dataclass(frozen=True)
class ElectrodeGeometry:
    """Lip of the shell over a flat electrode.

    Parameters
    ----------
    inner_radius_m, outer_radius_m : float
        R1, R2 of the lip.
    gap_m : float
        d.
    span_rad : float
        alpha, angle that one electrode covers.
    """

    inner_radius_m: float
    outer_radius_m: float
    gap_m: float
    span_rad: float

    def __post_init__(self) -> None:
        require_finite(self)
        require_positive(self, "inner_radius_m", "gap_m", "span_rad")
        if self.outer_radius_m <= self.inner_radius_m:
            raise DeviceError(f"ElectrodeGeometry outer_radius_m must exceed inner_radius_m, but got {self.outer_radius_m!r}.")

    @property
    def radius_m(self) -> float:
        """Mean radius R."""
        return 0.5 * (self.inner_radius_m + self.outer_radius_m)

    @property
    def area_m2(self) -> float:
        """Area of one electrode under the lip, ``alpha (R2^2 - R1^2) / 2``."""
        return 0.5 * self.span_rad * (self.outer_radius_m**2 - self.inner_radius_m**2)


@dataclass(frozen=True)
class Assembly:
    """How the shell sits on its electrodes.

    Parameters
    ----------
    inclination_rad, inclination_azimuth_rad : float
        sigma and beta_sigma: the gap grows by ``sigma r cos(beta - beta_sigma)``.
    eccentricity_m, eccentricity_azimuth_rad : float
        Displacement of the shell's axis from the centre of the electrodes.
    """

    inclination_rad: float = 0.0
    inclination_azimuth_rad: float = 0.0
    eccentricity_m: float = 0.0
    eccentricity_azimuth_rad: float = 0.0

    def __post_init__(self) -> None:
        require_finite(self)
        require_non_negative(self, "eccentricity_m")

    def electrode_azimuth(self, azimuth_rad: float, radius_m: float) -> float:
        """Azimuth of an electrode seen from the axis of the shell [rad]; its excess is lambda of document 004."""
        e, at = self.eccentricity_m, self.eccentricity_azimuth_rad
        x = radius_m * math.cos(azimuth_rad) - e * math.cos(at)
        y = radius_m * math.sin(azimuth_rad) - e * math.sin(at)
        return azimuth_rad + math.remainder(math.atan2(y, x) - azimuth_rad, 2.0 * math.pi)


@dataclass(frozen=True)
class DriveCircuit:
    """Bias, film and control circuits.

    Parameters
    ----------
    bias_v : float
        u_DC at the stem.
    film_x_ohm, film_y_ohm : float
        Film resistance between the stem and the lip at each channel's electrodes.
    leak_ohm : float
        Resistance of the leakage at the lip that draws the current; infinite: no drop.
    gain : float
        G_e, volts at the X electrode per commanded volt.
    gain_error : float
        Delta G_e of channel Y.
    coupling : float
        eta: share of each channel that reaches the other's electrode.
    """

    bias_v: float
    film_x_ohm: float = 0.0
    film_y_ohm: float = 0.0
    leak_ohm: float = math.inf
    gain: float = 1.0
    gain_error: float = 0.0
    coupling: float = 0.0

    def __post_init__(self) -> None:
        require_positive(self, "bias_v", "leak_ohm", "gain")
        require_non_negative(self, "film_x_ohm", "film_y_ohm")

    @property
    def bias_at_lip_v(self) -> tuple[float, float]:
        """u_DC_X and u_DC_Y [V]: what the film leaves of the bias."""
        return self.bias_v / (1.0 + self.film_x_ohm / self.leak_ohm), self.bias_v / (1.0 + self.film_y_ohm / self.leak_ohm)

    def matrix(self) -> FloatArray:
        """Volts at the electrodes per commanded volt, shape (2, 2) (document 004, Eq. 19)."""
        couplings = np.array([[1.0, self.coupling], [self.coupling, 1.0]])
        return couplings @ np.diag([self.gain, self.gain * (1.0 + self.gain_error)])


@dataclass(frozen=True)
class Unbalance:
    """A drive matrix as gain and errors: ``gain [[1, tan 2delta - tan 2lambda], [tan 2delta + tan 2lambda, 1 + delta_g]]``."""

    gain: float
    delta_g: float
    two_delta_rad: float
    two_lambda_rad: float


def capacitance(
    geometry: ElectrodeGeometry, assembly: Assembly, azimuth_rad: float, displacement_m: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Capacitance of one electrode [F] with the modes displaced by (x, y): the gap is ``d + tilt + x cos 2beta + y sin 2beta``."""
    r, beta, weight = _grid(geometry, assembly.electrode_azimuth(azimuth_rad, geometry.radius_m))
    return VACUUM_PERMITTIVITY * float((weight * r / _gap(geometry, assembly, r, beta, displacement_m)).sum())


def capacitance_slope(geometry: ElectrodeGeometry, assembly: Assembly, azimuth_rad: float) -> FloatArray:
    """dC/dx and dC/dy at rest [F/m], shape (2,)."""
    r, beta, weight = _grid(geometry, assembly.electrode_azimuth(azimuth_rad, geometry.radius_m))
    density = -VACUUM_PERMITTIVITY * weight * r / _gap(geometry, assembly, r, beta, (0.0, 0.0)) ** 2
    return np.array([(density * np.cos(2.0 * beta)).sum(), (density * np.sin(2.0 * beta)).sum()])


def drive_matrix(geometry: ElectrodeGeometry, assembly: Assembly, circuit: DriveCircuit, modal_mass_kg: float) -> FloatArray:
    """B [m/s^2/V], shape (2, 2): force per modal mass at the frequency of the command, ``u_DC u dC/dz / m`` (Eq. 12)."""
    at_lip = circuit.bias_at_lip_v
    columns = [
        bias * capacitance_slope(geometry, assembly, azimuth) for bias, azimuth in zip(at_lip, (X_AZIMUTH_RAD, Y_AZIMUTH_RAD), strict=True)
    ]
    return np.asarray(np.column_stack(columns) @ circuit.matrix() / modal_mass_kg)


def unbalance_of(matrix: FloatArray) -> Unbalance:
    """Gain and errors of any drive matrix with a first element."""
    gain = float(matrix[0, 0])
    xy, yx = float(matrix[0, 1]) / gain, float(matrix[1, 0]) / gain
    return Unbalance(gain, float(matrix[1, 1]) / gain - 1.0, math.atan(0.5 * (yx + xy)), math.atan(0.5 * (yx - xy)))


def first_order_unbalance(geometry: ElectrodeGeometry, assembly: Assembly, circuit: DriveCircuit, modal_mass_kg: float) -> Unbalance:
    """The document's model in closed form: gap at the middle of each electrode, products of errors dropped (Eqs. 9, 12-21).

    Where the document takes one lambda for both channels, eccentricity turns them by ``lambda_X`` and ``lambda_Y``: their sum is 2 lambda,
    their difference adds to 2 delta.
    """
    g, bias = geometry, circuit.bias_at_lip_v
    turns = [assembly.electrode_azimuth(at, g.radius_m) - at for at in (X_AZIMUTH_RAD, Y_AZIMUTH_RAD)]
    tilts = [
        assembly.inclination_rad * g.radius_m * math.cos(at - assembly.inclination_azimuth_rad) for at in (X_AZIMUTH_RAD, Y_AZIMUTH_RAD)
    ]
    forces = [VACUUM_PERMITTIVITY * g.area_m2 / (g.gap_m + tilt) ** 2 for tilt in tilts]
    gain = circuit.gain * forces[0] * bias[0] * math.cos(2.0 * turns[0]) / modal_mass_kg
    delta_g = (forces[1] / forces[0] - 1.0) + (bias[1] / bias[0] - 1.0) + circuit.gain_error
    return Unbalance(gain, delta_g, math.atan(circuit.coupling) + turns[0] - turns[1], turns[0] + turns[1])


def drive_chain(geometry: ElectrodeGeometry, assembly: Assembly, circuit: DriveCircuit, modal_mass_kg: float) -> DriveChain:
    """The drive chain of a device with this sensing head and circuit, integrated over the electrodes."""
    u = unbalance_of(drive_matrix(geometry, assembly, circuit, modal_mass_kg))
    return DriveChain(u.gain, gain_mismatch=u.delta_g, two_delta_rad=u.two_delta_rad, two_lambda_rad=u.two_lambda_rad)


def _grid(geometry: ElectrodeGeometry, centre_rad: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Radius, azimuth and weight of Gauss-Legendre nodes over an electrode, shape (nodes, nodes) each."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    width = geometry.outer_radius_m - geometry.inner_radius_m
    r = (geometry.radius_m + 0.5 * width * node)[:, None] + np.zeros(_NODES)
    beta = np.zeros((_NODES, 1)) + centre_rad + 0.5 * geometry.span_rad * node
    return r, beta, 0.25 * width * geometry.span_rad * np.outer(weight, weight)


def _gap(
    geometry: ElectrodeGeometry, assembly: Assembly, r: FloatArray, beta: FloatArray, displacement_m: tuple[float, float]
) -> FloatArray:
    tilt = assembly.inclination_rad * r * np.cos(beta - assembly.inclination_azimuth_rad)
    gap = geometry.gap_m + tilt + displacement_m[0] * np.cos(2.0 * beta) + displacement_m[1] * np.sin(2.0 * beta)
    if gap.min() <= 0.0:
        raise DeviceError(f"Gap must stay open, but got {gap.min():.3g} m at an electrode. Reduce inclination or displacement.")
    return np.asarray(gap)
