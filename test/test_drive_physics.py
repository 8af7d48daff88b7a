"""The drive chain from first principles against closed forms, numerical derivatives and the document's model."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gyro_calib.device import load_device
from gyro_calib.device.drive_physics import (
    VACUUM_PERMITTIVITY,
    X_AZIMUTH_RAD,
    Y_AZIMUTH_RAD,
    Assembly,
    DriveCircuit,
    ElectrodeGeometry,
    capacitance,
    capacitance_slope,
    drive_chain,
    drive_matrix,
    first_order_unbalance,
    unbalance_of,
)
from gyro_calib.errors import DeviceError

#: document 004, Table 1
HEAD = ElectrodeGeometry(9.65e-3, 10.35e-3, 15e-6, math.radians(40.0))
MASS_KG = 5e-4
CROOKED = Assembly(inclination_rad=2e-5, inclination_azimuth_rad=0.4, eccentricity_m=25e-6, eccentricity_azimuth_rad=1.1)


def test_capacitance_of_a_straight_head_is_that_of_a_plate() -> None:
    coulomb = 8.9875518e9
    plate = HEAD.span_rad * (10.35e-3**2 - 9.65e-3**2) / (8.0 * math.pi * coulomb * HEAD.gap_m)
    for azimuth in np.linspace(0.0, 2.0 * math.pi, 5):
        assert capacitance(HEAD, Assembly(), float(azimuth)) == pytest.approx(plate, rel=1e-8)
    assert HEAD.area_m2 * VACUUM_PERMITTIVITY / HEAD.gap_m == pytest.approx(plate, rel=1e-8)


@pytest.mark.parametrize("azimuth", [X_AZIMUTH_RAD, Y_AZIMUTH_RAD, 0.3])
def test_slope_is_the_derivative_of_the_integrated_capacitance(azimuth: float) -> None:
    step = 1e-9
    slope = capacitance_slope(HEAD, CROOKED, azimuth)
    x = capacitance(HEAD, CROOKED, azimuth, (step, 0.0)) - capacitance(HEAD, CROOKED, azimuth, (-step, 0.0))
    y = capacitance(HEAD, CROOKED, azimuth, (0.0, step)) - capacitance(HEAD, CROOKED, azimuth, (0.0, -step))
    np.testing.assert_allclose(slope, np.array([x, y]) / (2.0 * step), rtol=1e-6)


def test_a_perfect_head_drives_each_mode_by_its_own_channel_less_by_the_span() -> None:
    circuit = DriveCircuit(bias_v=200.0, gain=0.1)
    matrix = drive_matrix(HEAD, Assembly(), circuit, MASS_KG)
    point = 0.1 * 200.0 * VACUUM_PERMITTIVITY * HEAD.area_m2 / HEAD.gap_m**2 / MASS_KG
    np.testing.assert_allclose(matrix, point * math.sin(HEAD.span_rad) / HEAD.span_rad * np.eye(2), rtol=1e-9, atol=1e-14)
    assert first_order_unbalance(HEAD, Assembly(), circuit, MASS_KG).gain == pytest.approx(point, rel=1e-12)


def test_the_packaged_hemispheres_have_the_gain_of_this_head() -> None:
    gain = drive_matrix(HEAD, Assembly(), DriveCircuit(bias_v=200.0, gain=0.1), MASS_KG)[0, 0]
    for name in ("hrg_sun2024", "hrg_hardware"):
        device = load_device(name)
        assert device.drive.gain_m_s2_per_v == pytest.approx(gain, rel=1e-5)
        assert device.resonator.modal_mass_kg == MASS_KG


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_narrow_electrodes_reduce_to_the_model_of_the_document_to_second_order(share: float) -> None:
    narrow = replace(HEAD, span_rad=0.02)
    assembly = replace(CROOKED, inclination_rad=share * 3e-5, eccentricity_m=share * 40e-6)
    circuit = DriveCircuit(200.0, 1e6, 1e6 + share * 6e6, 1e9, 0.1, share * 4e-3, share * -3e-3)
    exact = unbalance_of(drive_matrix(narrow, assembly, circuit, MASS_KG))
    model = first_order_unbalance(narrow, assembly, circuit, MASS_KG)
    largest = max(abs(exact.delta_g), abs(exact.two_delta_rad), abs(exact.two_lambda_rad))
    assert largest > share * 5e-3
    # the coupling of an unequal circuit and the span leave the second order
    second = 2.0 * largest**2 + 1e-4 * largest
    assert exact.delta_g == pytest.approx(model.delta_g, abs=second)
    assert exact.two_delta_rad == pytest.approx(model.two_delta_rad, abs=second)
    assert exact.two_lambda_rad == pytest.approx(model.two_lambda_rad, abs=second)
    assert exact.gain == pytest.approx(model.gain, rel=second + 1e-4)


def test_tilt_of_a_wide_electrode_turns_its_drive_which_the_document_leaves_out() -> None:
    tilt = 1e-7
    assembly = Assembly(inclination_rad=tilt, inclination_azimuth_rad=0.1)
    circuit = DriveCircuit(bias_v=200.0)
    exact = unbalance_of(drive_matrix(HEAD, assembly, circuit, MASS_KG))
    model = first_order_unbalance(HEAD, assembly, circuit, MASS_KG)
    assert model.two_lambda_rad == 0.0
    turns = [HEAD.span_rad**2 * tilt * HEAD.radius_m * math.sin(at - 0.1) / (6.0 * HEAD.gap_m) for at in (X_AZIMUTH_RAD, Y_AZIMUTH_RAD)]
    # leading order in the span, itself 0.7 rad
    assert exact.two_lambda_rad == pytest.approx(sum(turns), rel=0.04)
    assert exact.two_delta_rad == pytest.approx(turns[0] - turns[1], rel=0.04)


def test_each_cause_shows_in_its_own_error() -> None:
    straight = Assembly()
    film = unbalance_of(drive_matrix(HEAD, straight, DriveCircuit(200.0, 1e6, 11e6, 1e9), MASS_KG))
    assert film.delta_g == pytest.approx(1.001 / 1.011 - 1.0, rel=1e-9)
    gain = unbalance_of(drive_matrix(HEAD, straight, DriveCircuit(200.0, gain_error=0.02), MASS_KG))
    assert gain.delta_g == pytest.approx(0.02, rel=1e-9)
    crosstalk = unbalance_of(drive_matrix(HEAD, straight, DriveCircuit(200.0, coupling=0.003), MASS_KG))
    assert crosstalk.two_delta_rad == pytest.approx(math.atan(0.003), rel=1e-9)
    assert crosstalk.two_lambda_rad == pytest.approx(0.0, abs=1e-12)
    # displaced along 112.5 degrees, between the electrodes: they turn apart; across it, they turn together
    apart = Assembly(eccentricity_m=20e-6, eccentricity_azimuth_rad=math.radians(112.5))
    across = Assembly(eccentricity_m=20e-6, eccentricity_azimuth_rad=math.radians(22.5))
    turn = 20e-6 / HEAD.radius_m
    shape = [unbalance_of(drive_matrix(HEAD, a, DriveCircuit(200.0), MASS_KG)) for a in (apart, across)]
    assert shape[0].two_lambda_rad == pytest.approx(0.0, abs=1e-5)
    assert abs(shape[0].two_delta_rad) == pytest.approx(2.0 * turn * math.sin(math.radians(22.5)), rel=1e-2)
    assert shape[1].two_lambda_rad == pytest.approx(2.0 * turn * math.cos(math.radians(22.5)), rel=1e-2)


def test_the_drive_chain_gives_the_matrix_back() -> None:
    circuit = DriveCircuit(200.0, 1e6, 3e6, 1e9, 0.1, 0.004, 0.002)
    matrix = drive_matrix(HEAD, CROOKED, circuit, MASS_KG)
    np.testing.assert_allclose(drive_chain(HEAD, CROOKED, circuit, MASS_KG).matrix(), matrix, rtol=1e-9)


def test_impossible_heads_are_refused() -> None:
    with pytest.raises(DeviceError, match="Gap must stay open"):
        drive_matrix(HEAD, Assembly(inclination_rad=2e-3), DriveCircuit(200.0), MASS_KG)
    with pytest.raises(DeviceError, match=r"outer_radius_m must exceed inner_radius_m, but got 0\.009"):
        ElectrodeGeometry(0.01, 0.009, 1e-5, 0.5)
    with pytest.raises(DeviceError, match=r"bias_v must be > 0, but got 0\.0"):
        DriveCircuit(0.0)
    with pytest.raises(DeviceError, match="film_x_ohm must be >= 0"):
        DriveCircuit(200.0, film_x_ohm=-1.0)
    with pytest.raises(DeviceError, match="inclination_rad must be finite"):
        Assembly(inclination_rad=math.inf)
