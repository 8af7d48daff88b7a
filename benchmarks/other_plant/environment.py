"""What changes slowly around a unit: temperature, rate and the 1/f wander of gains, on the grid that plant.c interpolates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from kernel import SLOW, Array
from unit import Unit


@dataclass
class Scene:
    """A campaign about to be run: an effect adds to ``par`` and ``slow`` and may change what the thermometer reads.

    Attributes
    ----------
    unit : Unit
    par : dict
        Parameters of plant.c.
    t, temperature, rate : ndarray
        Grid, true temperature of the resonator [degC] and rate of table and bench [rad/s].
    reading : ndarray
        What the thermometer says before its noise.
    slow : ndarray
        Slow variables of plant.c on the grid.
    """

    unit: Unit
    par: dict[str, float]
    t: Array
    temperature: Array
    rate: Array
    reading: Array
    slow: Array

    def add(self, name: str, value: Array | float) -> None:
        """Add to a slow variable."""
        self.slow[:, SLOW[name]] += value

    def bump(self, name: str, value: float) -> None:
        """Add to a parameter of plant.c."""
        self.par[name] = self.par.get(name, 0.0) + value

    @property
    def warm(self) -> Array:
        """Kelvin above the reference."""
        return self.temperature - 25.0

    @property
    def span(self) -> float:
        """Length of the campaign [s]."""
        return float(self.t[-1])


def lag(x: Array, tau: float, dt: float) -> Array:
    """First-order lag that has settled before the first sample."""
    a = np.exp(-dt / tau)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], x, zi=[a * x[0]])[0])


def flicker(rng: np.random.Generator, n: int, dt: float, rms: float) -> Array:
    """Noise with a spectrum of 1/f down to the length of the campaign; drawn coarsely, it has nothing above a hertz."""
    coarse = int(n * dt / 0.5) + 4
    spectrum = rng.normal(size=coarse // 2 + 1) + 1j * rng.normal(size=coarse // 2 + 1)
    f = np.arange(coarse // 2 + 1, dtype=float)
    f[0] = np.inf
    x = np.fft.irfft(spectrum / np.sqrt(f), coarse)
    x *= rms / np.std(x)
    return np.asarray(np.interp(np.arange(n) * dt, np.arange(coarse) * 0.5, x))


def walk_back(rng: np.random.Generator, n: int, dt: float, rms: float, tau: float) -> Array:
    """Ornstein-Uhlenbeck wander."""
    coarse = int(n * dt / 0.25) + 4
    a = np.exp(-0.25 / tau)
    x = lfilter([np.sqrt(1.0 - a * a) * rms], [1.0, -a], rng.normal(size=coarse), zi=[a * rng.normal() * rms])[0]
    return np.asarray(np.interp(np.arange(n) * dt, np.arange(coarse) * 0.25, x))


def build_scene(
    unit: Unit, span: float, ramps: list[tuple[float, float, float]], tables: list[Array], rng: np.random.Generator, quiet: bool = False
) -> Scene:
    """Draw the environment of a campaign.

    Parameters
    ----------
    unit : Unit
    span : float
        Length of the campaign [s].
    ramps : list of (start, target, duration)
        Of the chamber.
    tables : list of ndarray, shape (n, 2)
        Corners of the profiles of the rate table: time [s], rate [rad/s].
    rng : Generator
    quiet : bool
        Without any wander (for checks).
    """
    par = unit.parameters()
    dt = par["SLOW_DT"]
    n = int(span / dt) + 200
    t: Array = np.arange(n, dtype=np.float64) * dt
    corners = [(0.0, 25.0)]
    for start, target, duration in sorted(ramps):
        corners += [(start, corners[-1][1]), (start + duration, target)]
    chamber = np.interp(t, *np.array(corners).T)
    temperature = lag(chamber, unit.heater_lag, dt)
    rate = np.full(n, unit.rate)
    for profile in tables:
        rate += np.interp(t, profile[:, 0], profile[:, 1], left=0.0, right=0.0)
    slow = np.zeros((n, len(SLOW)))
    slow[:, SLOW["OMEGA"]] = rate
    if quiet:
        return Scene(unit, par, t, temperature, rate, temperature.copy(), slow)
    temperature = temperature + walk_back(rng, n, dt, unit.wander["temperature"], unit.wander["temperature_s"])
    scene = Scene(unit, par, t, temperature, rate, lag(temperature, unit.thermometer["lag"], dt), slow)
    warm, tc, g = scene.warm, unit.tc, unit.wander["gain"]
    scene.add("K0", 2.0 * unit.w0 * tc["frequency"] * warm)
    more = (1.0 + warm / 298.15) ** (tc["damping"] * 298.15) - 1.0
    scene.add("D0", 2.0 / unit.tau * more)
    scene.add("DC", unit.damping_split[0] * more)
    scene.add("DS", unit.damping_split[1] * more)
    for sign, a in ((1.0, "X"), (-1.0, "Y")):
        scene.add(f"GP{a}{a}", (tc["gain_pick"] + sign * tc["gain_pick_difference"]) * warm + flicker(rng, n, dt, g))
        scene.add(f"GD{a}{a}", (tc["gain_drive"] + sign * tc["gain_drive_difference"]) * warm + flicker(rng, n, dt, g))
        scene.add(f"PHP{a}", tc["phase"] * warm)
    return scene
