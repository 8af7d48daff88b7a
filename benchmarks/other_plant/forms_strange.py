"""How the strangers of `effects_strange` change a scene: pieces that the table there puts together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from effect import Apply, Draw, Shape, axis, axis_name, sign
from environment import Scene, lag
from kernel import Array
from unit import TWO_PI, Unit


def events(mean: float, low: float, high: float) -> Draw:
    """Draw the seed of a random pattern in time: mean number of steps, mean dwell in the low and in the high state [s]."""

    def draw(rng: np.random.Generator, unit: Unit) -> Shape:
        return {**axis(rng, unit), "pattern": float(rng.integers(1, 2**31)), "mean": mean, "low": low, "high": high}

    return draw


def lasting(low: float, high: float) -> Draw:
    """Draw a sign and a time constant [s]."""

    def draw(rng: np.random.Generator, unit: Unit) -> Shape:
        return {**sign(rng, unit), "tau": float(rng.uniform(low, high))}

    return draw


def threshold(low: float, high: float) -> Draw:
    """Draw a sign and a threshold [V]."""

    def draw(rng: np.random.Generator, unit: Unit) -> Shape:
        return {**sign(rng, unit), "at": float(rng.uniform(low, high))}

    return draw


def standing_wave(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw temperature and width of an acoustic resonance [K]."""
    return {"at": float(rng.uniform(27.5, 30.5)), "width": float(rng.uniform(0.5, 1.2))}


def direction(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw a direction in the plane of an anisotropy."""
    angle = rng.uniform(0, TWO_PI)
    return {"c": float(np.cos(angle)), "s": float(np.sin(angle))}


def dose(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw the kelvin seconds that drive out most of a gas."""
    return {"dose": float(rng.uniform(60.0, 150.0))}


def mount_frequency(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw the frequency of a mount, where the rows still see it."""
    return {"hz": float(rng.uniform(3.0, 0.06 * unit.row_rate + 2.0))}


def per_volts(ring: float, hrg: float) -> Callable[[Unit], float]:
    """A first size for each kind: their drives differ."""
    return lambda unit: ring if unit.kind == "ring" else hrg


def telegraph(scene: Scene, shape: Shape) -> Array:
    """Two states with exponential dwell times of mean ``low`` and ``high`` seconds."""
    rng = np.random.default_rng(int(shape["pattern"]))
    out, now, state = np.zeros(len(scene.t)), 0.0, False
    while now < scene.span:
        dwell = float(rng.exponential(shape["high"] if state else shape["low"]))
        if state:
            out[(scene.t >= now) & (scene.t < now + dwell)] = 1.0
        now, state = now + dwell, not state
    return out


def steps(scene: Scene, shape: Shape) -> Array:
    """A staircase of a few steps of either sign at drawn times."""
    rng = np.random.default_rng(int(shape["pattern"]))
    n = max(3, rng.poisson(shape["mean"]))
    out = np.zeros(len(scene.t))
    for at, height in zip(rng.uniform(0.08, 0.92, n) * scene.span, rng.choice([-1.0, 1.0], n) * rng.uniform(0.6, 1.4, n), strict=True):
        out += height * (scene.t >= at)
    return np.asarray(out - out.mean())


def play(scene: Scene, x: Array, width: float, every: int) -> Array:
    """Play operator, a hand that is dragged along with some slack; it moves slowly, so every few points will do."""
    coarse = x[::every]
    out, hand = np.empty_like(coarse), coarse[0]
    for i, v in enumerate(coarse):
        hand = min(max(hand, v - width), v + width)
        out[i] = hand
    return np.interp(scene.t, scene.t[::every], out)


def contact(scene: Scene, size: float, shape: Shape) -> None:
    """A pick-off loses gain while its contact is open."""
    a = axis_name(shape)
    scene.add(f"GP{a}{a}", -size * telegraph(scene, shape))


def relay(scene: Scene, size: float, shape: Shape) -> None:
    """A drive hops between two gains."""
    a = axis_name(shape)
    scene.add(f"GD{a}{a}", size * telegraph(scene, shape))


def stick_slip(scene: Scene, size: float, shape: Shape) -> None:
    """One part of the stiffness anisotropy jumps."""
    scene.add("KS" if shape["axis"] else "KC", TWO_PI * size * steps(scene, shape))


def clock_hops(scene: Scene, size: float, shape: Shape) -> None:
    """A fast clock shows every frequency of the resonator too low."""
    scene.add("K0", -2.0 * scene.unit.w0 * size * steps(scene, shape))


def acoustic(scene: Scene, size: float, shape: Shape) -> None:
    """A resonance of the gas, over temperature, in damping and frequency."""
    z = (scene.temperature - shape["at"]) / shape["width"]
    line = 1.0 / (1.0 + z**2)
    scene.add("D0", 2.0 / scene.unit.tau * size * line)
    scene.add("K0", 2.0 / scene.unit.tau * size * z * line)


def hysteresis(scene: Scene, size: float, shape: Shape) -> None:
    """Stiffness anisotropy with the slack between the temperature and what follows it."""
    value = play(scene, scene.temperature, 1.5, 20) - scene.temperature
    scene.add("KC", TWO_PI * size * shape["c"] * value)
    scene.add("KS", TWO_PI * size * shape["s"] * value)


def outgassing(scene: Scene, size: float, shape: Shape) -> None:
    """Gas that comes out while it is warm and stays."""
    gas = np.cumsum(np.maximum(scene.warm - 2.0, 0.0)) * scene.par["SLOW_DT"]
    scene.add("D0", 2.0 / scene.unit.tau * size * (1.0 - np.exp(-gas / shape["dose"])))


def gradient_rate(scene: Scene, size: float, shape: Shape) -> None:
    """A rate with the lagged slope of the temperature."""
    dt = scene.par["SLOW_DT"]
    scene.add("OMEGA", size * shape["sign"] * np.gradient(lag(scene.temperature, shape["tau"], dt), dt))


def mount(scene: Scene, size: float, shape: Shape) -> None:
    """The case on a torsion spring: the size is the share of the rate that swings after each step of the table."""
    dt, w, z = scene.par["SLOW_DT"], TWO_PI * shape["hz"], 0.02
    table = scene.rate - scene.unit.rate
    a = [1.0, -2.0 * np.exp(-z * w * dt) * np.cos(w * dt), np.exp(-2 * z * w * dt)]
    scene.add("OMEGA", size * (lfilter([0.0, sum(a)], a, table) - table))


def rate_hysteresis(scene: Scene, size: float, shape: Shape) -> None:
    """The rate acts with play."""
    table = scene.rate - scene.unit.rate
    scene.add("OMEGA", size * shape["sign"] * (play(scene, table, 0.3, 2) - table))


def creeping_glue(scene: Scene, size: float, shape: Shape) -> None:
    """A stress, and with it a cross stiffness, that follows the square of the rate in seconds."""
    table = scene.rate - scene.unit.rate
    scene.add("KS", lag(table**2, shape["tau"], scene.par["SLOW_DT"]) * TWO_PI * size)


def heater_current(scene: Scene, size: float, shape: Shape) -> None:
    """Opposite phases of the pick-offs while the heater works; holding a temperature takes a little of its power."""
    dt = scene.par["SLOW_DT"]
    power = np.maximum(np.gradient(lag(scene.temperature, 0.5, dt), dt), 0.0) + 0.05 * np.maximum(scene.warm, 0.0)
    scene.add("PHPX", size * power)
    scene.add("PHPY", -size * power)


def ranging(scene: Scene, size: float, shape: Shape) -> None:
    """Another gain above a threshold of the amplitude, with hysteresis."""
    scene.par.update(RANGE_STEP=size * shape["sign"], RANGE_HI=shape["at"] + 0.02, RANGE_LO=shape["at"] - 0.02)


def code_step(scene: Scene, size: float, shape: Shape) -> None:
    """A step of the converters' transfer curve."""
    scene.par.update(PKDNL=size * shape["sign"], PKDNL_V=shape["at"])


def heat(name: str) -> Apply:
    """A parameter of plant.c that goes with the low-passed drive power."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        scene.par["HEAT_TAU"] = shape["tau"]
        scene.bump(name, size * shape["sign"])

    return apply


def self_heating(scene: Scene, size: float, shape: Shape) -> None:
    """Kelvin per square volt of the wave that the thermometer does not see."""
    scene.par.update(SELF_TAU=shape["tau"], SELF_K=2.0 * size * scene.unit.w0 * scene.unit.tc["frequency"])


def fatigue(scene: Scene, size: float, shape: Shape) -> None:
    """Damping with the low-passed energy."""
    scene.par.update(FATIGUE_TAU=shape["tau"], FATIGUE_D=2.0 / scene.unit.tau * size)


def subharmonic(scene: Scene, size: float, shape: Shape) -> None:
    """A mode that is pumped above a threshold, in some tenths of a second."""
    gain = 2.0
    scene.par.update(SUB_GAIN=gain, SUB_LOSS=gain * shape["at"] ** 2, SUB_D=2.0 / scene.unit.tau * size)


def simple(name: str) -> Apply:
    """One parameter of plant.c, with a sign if it has one."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        scene.bump(name, size * shape.get("sign", 1.0))

    return apply


def end_stop(scene: Scene, size: float, shape: Shape) -> None:
    """A spring beyond a deflection, on one side."""
    scene.par.update(STOP_K=size, STOP_X0=shape["at"])
