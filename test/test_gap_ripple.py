"""What loops answer that read a ripple at twice the reference: of a carrier whose loops do, sample by sample, not of the columns' law."""

import cmath

import numpy as np
from numpy.typing import NDArray

from gyro_calib.gap.ripple import answers

FloatArray, ComplexArray = NDArray[np.float64], NDArray[np.complex128]

#: carrier and its samples [Hz], decay [1/s], drive [1/s], precession [rad/s], the follower's and the quadrature loop's bandwidth [rad/s]
_F0_HZ, _RATE_HZ, _DECAY, _G, _SPEED, _FOLLOWS, _LOOP = 500.3, 8000, 0.07, 0.1, 0.4, 600.0, 60.0
#: samples that a command is held, samples a row
_HELD, _ROW = 5, 160
#: no feedthrough; one that is unlike along the axes; one along the diagonals
_FED = 5e-4j * np.array([np.zeros((2, 2)), np.diag([1.0, -1.0]), [[0.0, 1.0], [1.0, 0.0]]])


def _commands(followed: ComplexArray, integral: FloatArray) -> ComplexArray:
    """Drives that hold amplitude and quadrature and turn the wave, from the phasors of this moment, shape (cases, 2)."""
    x, y = followed.T
    psi = 0.5 * np.arctan2(2.0 * (x.conj() * y).real, np.abs(x) ** 2 - np.abs(y) ** 2)
    wave = np.stack([np.cos(psi), np.sin(psi)], axis=1)
    wave *= np.sign(np.sum(wave * followed.real, axis=1))[:, None]
    across = np.stack([-wave[:, 1], wave[:, 0]], axis=1)
    amplitude, quadrature = np.sum(wave * followed.real, axis=1), np.sum(across * followed.imag, axis=1)
    integral += _LOOP / 30.0 * _HELD / _RATE_HZ * _LOOP / _G * quadrature
    along = _DECAY / _G + _LOOP / _G * (1.0 - amplitude)
    return 1j * (along[:, None] * wave + _SPEED / _G * across) + (_LOOP / _G * quadrature + integral)[:, None] * across


def _rows(feedthrough: ComplexArray, seconds: float = 10.0) -> ComplexArray:
    """Pick-offs and drives of waves that precess, as they are recorded, each of shape (rows, cases, 2)."""
    decays = cmath.exp((2j * np.pi * _F0_HZ - _DECAY) / _RATE_HZ)
    # two oscillators as complex numbers whose real part is read and whose imaginary part is the velocity, which forces move
    wave = np.tile([1.0 + 0j, 0j], (len(feedthrough), 1))
    followed, integral = wave.copy(), np.zeros(len(feedthrough))
    drive = commanded = np.zeros_like(wave)
    rows, sums = [], np.zeros((2, *wave.shape), complex)
    for n in range(int(seconds * _RATE_HZ)):
        turn = cmath.exp(2j * np.pi * _F0_HZ * n / _RATE_HZ)
        if n % _HELD == 0:
            drive, commanded = commanded, _commands(followed, integral)
        volts = wave.real + (np.einsum("cij,cj->ci", feedthrough, drive) * turn).real
        followed = followed + 2.0 * _FOLLOWS / _RATE_HZ * (volts - (followed * turn).real) * turn.conjugate()
        sums += 2.0 * volts * turn.conjugate(), drive
        if (n + 1) % _ROW == 0:
            rows.append(sums / _ROW)
            sums = np.zeros_like(sums)
        wave = decays * (wave - 2j * _G / _RATE_HZ * (drive * turn).real)
    return np.moveaxis(np.array(rows), 1, 0)


def test_what_feeds_through_makes_an_answer_that_goes_with_the_azimuth() -> None:
    row_s = _ROW / _RATE_HZ
    within = slice(int(1.5 / row_s), -int(0.3 / row_s))
    sizes = []
    for pick, drive, feedthrough in zip(*np.moveaxis(_rows(_FED), 2, 1), _FED, strict=True):
        motion = pick - drive @ feedthrough.T
        speed = np.gradient(motion, row_s, axis=0)
        beside = (speed + _DECAY * motion + 1j * _G * drive)[within].ravel()
        shapes = {k: v[within].ravel() for k, v in answers(motion, speed).items() if k.startswith("across")}
        sizes.append(dict(zip(shapes, np.linalg.lstsq(np.array(list(shapes.values())).T, beside, rcond=None)[0], strict=True)))
    without, axes, diagonals = sizes
    for found, seen, other in (axes, "across_1c", "across_1s"), (diagonals, "across_1s", "across_1c"):
        assert 0.03 < abs(found[seen] - without[seen]) / abs(without["across"]) < 0.1
        assert abs(found[other] - without[other]) < 0.1 * abs(found[seen] - without[seen])
        assert abs(found["across"] - without["across"]) < 0.01 * abs(without["across"])
