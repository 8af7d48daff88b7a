"""How the effects of `effects_known` change a scene: pieces that the table there puts together."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from effect import Apply, Shape, axis_name
from environment import Scene
from kernel import Array
from unit import TWO_PI, Unit

Course = Callable[[Scene], Array]


def bump(*names: str) -> Apply:
    """Set parameters of plant.c to the size."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        for name in names:
            scene.bump(name, size * shape.get("sign", 1.0))

    return apply


def bump_axis(stem: str) -> Apply:
    """Set the parameter of one axis, with its sign if it has one."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        scene.bump(stem + axis_name(shape), size * shape["sign"])

    return apply


def bump_axis_positive(stem: str) -> Apply:
    """Set the parameter of one axis to a size that is a loss, whatever the sign drawn."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        scene.bump(stem + axis_name(shape), size)

    return apply


def direction(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw a direction in the plane of an anisotropy."""
    angle = float(rng.uniform(0, TWO_PI))
    return {"c": float(np.cos(angle)), "s": float(np.sin(angle))}


def over_time(scene: Scene) -> Array:
    """Course from -1/2 to 1/2 over the campaign."""
    return np.asarray(scene.t / scene.span - 0.5)


def over_temperature(scene: Scene) -> Array:
    """Course from 0 to 1 over the temperature step."""
    return np.asarray(scene.warm / 8.0)


def anisotropy(letter: str, course: Course, scale: Callable[[Unit], float]) -> Apply:
    """An anisotropy of the stiffness (K) or the damping (D) along a course."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        value = size * scale(scene.unit) * course(scene)
        scene.add(letter + "C", shape["c"] * value)
        scene.add(letter + "S", shape["s"] * value)

    return apply


def channel(stem: str, course: Course, doubled: bool) -> Apply:
    """Gain (doubled letters of the axis) or phase of one channel along a course."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        a = axis_name(shape)
        scene.add(stem + (a + a if doubled else a), size * shape["sign"] * course(scene))

    return apply


def damping(scene: Scene, size: float, shape: Shape) -> None:
    """Isotropic damping over time."""
    scene.add("D0", size * shape["sign"] * 2.0 / scene.unit.tau * over_time(scene))


def charge(scene: Scene, size: float, shape: Shape) -> None:
    """Trapped charge softens the springs with the square of the bias, towards saturation."""
    value = size * (1.0 - np.exp(-scene.t / (shape["tau"] * scene.span)))
    scene.add("K0", -shape["sign"] * 2.0 * value)


def charging(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw sign and time constant of a charge."""
    return {"sign": float(rng.choice([-1.0, 1.0])), "tau": float(rng.uniform(0.15, 0.3))}


def ageing(scene: Scene, size: float, shape: Shape) -> None:
    """Frequency over time."""
    scene.add("K0", 2.0 * size * shape["sign"] * over_time(scene))


def curvature(scene: Scene, size: float, shape: Shape) -> None:
    """Frequency bent over the temperature step, its ends held."""
    scene.add("K0", 2.0 * size * shape["sign"] * (scene.warm / 8.0) * (1.0 - scene.warm / 8.0) * 4.0)


def rate(form: Callable[[Array], Array]) -> Apply:
    """A function of the table's rate acts on top of it."""

    def apply(scene: Scene, size: float, shape: Shape) -> None:
        scene.add("OMEGA", size * shape["sign"] * form(scene.rate - scene.unit.rate))

    return apply


def centrifugal(scene: Scene, size: float, shape: Shape) -> None:
    """Stiffness with the square of the rate."""
    scene.add("K0", -2.0 * size * scene.rate**2)


def beside(rng: np.random.Generator, unit: Unit) -> Shape:
    """Draw a tone beside the carrier, where the rows still see it."""
    offset = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.16) * unit.row_rate)
    return {"offset_hz": offset, **direction(rng, unit)}


def shaken(scene: Scene, size: float, shape: Shape) -> None:
    """A steady force beside the carrier."""
    scene.par["TONE_W"] = scene.unit.w0 + TWO_PI * shape["offset_hz"]
    scene.bump("TONE_X", size * shape["c"])
    scene.bump("TONE_Y", size * shape["s"])


def interference(scene: Scene, size: float, shape: Shape) -> None:
    """A steady voltage beside the carrier."""
    scene.par["PKTONE_W"] = scene.unit.w0 + TWO_PI * shape["offset_hz"]
    scene.bump("PKTONE_X", size * shape["c"])
    scene.bump("PKTONE_Y", size * shape["s"])


def top_of_drive(rng: np.random.Generator, unit: Unit) -> Shape:
    """Largest drive of the campaign: open drives of the ring, the fastest precession of the hemisphere."""
    return {"top": 2.0 if unit.kind == "ring" else float(np.pi / (4.32 * unit.gain))}


def drive_rail(scene: Scene, size: float, shape: Shape) -> None:
    """The larger the size the lower the rail."""
    scene.par["DRSAT"] = shape["top"] / (1.0 + size)


def pick_rail(scene: Scene, size: float, shape: Shape) -> None:
    """A rail just below the largest signal of the campaign."""
    scene.par["PKSAT"] = (1.54 if scene.unit.kind == "ring" else 1.4) / (1.0 + size)


def loss(unit: Unit) -> float:
    """1/tau [1/s]."""
    return 1.0 / unit.tau


def turn(unit: Unit) -> float:
    """One hertz [rad/s]."""
    return TWO_PI
