"""The linear device of a campaign, fitted without effects until its resonance, its response to rate and its table's log are in place."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .column import Column
from .evidence import CampaignEvidence
from .followed import followed_of
from .linear_device import frequency_columns, knows_its_resonance, linear_columns, linear_of, reaction_of, target_of
from .noise import first_noise, measured_noise
from .nuisance import thermal_columns, wander_columns
from .parts import Linear
from .rate_table import gain_as_read, in_time, rate_columns, steps_of
from .system import NoiseByRole, Solution, Whitener, solve
from .wander import wander_within

__all__ = ["FittedDevice", "first_linear", "fitted_device", "nuisances_of"]

FloatArray = NDArray[np.float64]
#: delay and length of a table's steps from which on its log is mended [s], and how often
_TABLE_S, _TABLE_ROUNDS = 5e-4, 2


class FittedDevice(NamedTuple):
    """What is known before any effect is asked for.

    Parameters
    ----------
    evidence : CampaignEvidence
        With the log of its table mended as the fit says.
    linear : Linear
    values : dict
        Of all columns of the fit, by name.
    late_s : dict
        How much later than its log the table turned, by index of the recording.
    """

    evidence: CampaignEvidence
    linear: Linear
    values: dict[str, float]
    late_s: dict[int, float]


def first_linear(evidence: CampaignEvidence, angular_gain: float, wander_rad_s: float) -> tuple[Linear, dict[str, float], FloatArray]:
    """The linear device of which nothing was known, all values of its fit with rough noise, and how well it knows its drives.

    The last is the standard deviation of the gain of each drive on its own axis [1/s], shape (2,), by what the fit leaves.

    Parameters
    ----------
    evidence : CampaignEvidence
    angular_gain : float
        kappa of the factory.
    wander_rad_s : float
        How far the resonance wanders between records.
    """
    linear, solution = _linear(evidence, _first(evidence, wander_rad_s), angular_gain, 0.0)
    left = solution.chi2 / max(solution.residual.size - len(solution.columns), 1)
    places = [[c.name for c in solution.columns].index(f"G_{axis}{axis}_re") for axis in "xy"]
    return linear, solution.by_name(), np.sqrt(left * np.diag(solution.covariance)[places])


def fitted_device(evidence: CampaignEvidence, linear: Linear, angular_gain: float, wander_rad_s: float, most_rad_s: float) -> FittedDevice:
    """The linear device with where its resonance lay in every record, its response to rate as read, and its table in time.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
        From :func:`first_linear`.
    angular_gain : float
        kappa of the factory.
    wander_rad_s, most_rad_s : float
        How far a usual resonance wanders between records, and how far one may.
    """
    # what feeds through does not resonate: once E is known the frequency's column is right
    linear, _ = _linear(evidence, nuisances_of(evidence, linear, wander_rad_s, wander_rad_s), angular_gain, angular_gain)
    linear, values, noise = _resonant(evidence, nuisances_of(evidence, linear, most_rad_s, most_rad_s), angular_gain)
    angular_gain = gain_as_read(angular_gain, values)
    linear = replace(linear, angular_gain=angular_gain, reaction=reaction_of(values, angular_gain))
    return _in_time(evidence, linear, values, angular_gain, most_rad_s, noise)


def _first(evidence: CampaignEvidence, wander_rad_s: float) -> list[Column]:
    """What a device is fitted with of which nothing is known."""
    return [
        *linear_columns(evidence),
        *rate_columns(evidence),
        *frequency_columns(evidence),
        *wander_columns(evidence, wander_rad_s, wander_rad_s),
    ]


def nuisances_of(evidence: CampaignEvidence, linear: Linear, wander_rad_s: float, open_drive_rad_s: float) -> list[Column]:
    """Columns of a linear device, its table, its temperature and its wander.

    Parameters
    ----------
    evidence : CampaignEvidence
    linear : Linear
        As far as it is known.
    wander_rad_s, open_drive_rad_s : float
        How far the resonance wanders between records of a wave, and of an open drive, sd.
    """
    return [
        *linear_columns(evidence, linear),
        *rate_columns(evidence, linear),
        *frequency_columns(evidence),
        *thermal_columns(evidence, linear),
        *wander_columns(evidence, wander_rad_s, open_drive_rad_s),
    ]


def _linear(evidence: CampaignEvidence, columns: list[Column], angular_gain: float, known_gain: float) -> tuple[Linear, Solution]:
    """The linear device of a fit with rough noise, and the fit; ``known_gain``: response to rate that is taken as known."""
    whitener = Whitener.of(evidence, first_noise(evidence))
    target = whitener.rows(target_of(evidence, known_gain))
    return _told(evidence, columns, whitener, target, angular_gain)


def _resonant(
    evidence: CampaignEvidence, columns: list[Column], angular_gain: float, start: NoiseByRole | None = None
) -> tuple[Linear, dict[str, float], NoiseByRole]:
    """The linear device, and all values, with where its resonance lay in every record.

    That asks for noise of the right size, of a fit without effects.
    """
    noise, excess = measured_noise(evidence, columns, columns, angular_gain, start=start)
    whitener = Whitener.of(evidence, noise, excess)
    linear, solution = _told(evidence, columns, whitener, whitener.rows(target_of(evidence, angular_gain)), angular_gain)
    return linear, solution.by_name(), noise


def _told(
    evidence: CampaignEvidence, columns: list[Column], whitener: Whitener, target: NDArray[np.float64], angular_gain: float
) -> tuple[Linear, Solution]:
    """The linear device, with where its resonance lay, and the fit."""
    design = whitener.design(columns, len(evidence))
    solution = solve(columns, design, target)
    values = solution.by_name()
    if not knows_its_resonance(evidence, values):
        return linear_of(evidence, values, angular_gain), solution
    followed = followed_of(evidence, solution, whitener, design)
    linear = linear_of(evidence, values, angular_gain, followed)
    return replace(linear, followed=followed.with_wander(wander_within(evidence, linear))), solution


def _in_time(
    evidence: CampaignEvidence,
    linear: Linear,
    values: dict[str, float],
    angular_gain: float,
    most_rad_s: float,
    noise: NoiseByRole,
) -> FittedDevice:
    """The recordings with the log of their table mended as the fit says, and their own fit."""
    logged, late_s, length_s = evidence, dict[int, float](), 0.0
    for k in range(_TABLE_ROUNDS):
        later, longer = steps_of(values, angular_gain)
        if max([abs(x) for x in later.values()] + [longer]) < _TABLE_S:
            break
        late_s = {i: late_s.get(i, 0.0) + x for i, x in later.items()}
        # of a log that is late its second moment says little
        length_s = math.hypot(length_s, longer) if k else 0.0
        evidence = in_time(logged, late_s, length_s)
        linear, values, noise = _resonant(evidence, nuisances_of(evidence, linear, most_rad_s, most_rad_s), angular_gain, noise)
    return FittedDevice(evidence, linear, values, late_s)
