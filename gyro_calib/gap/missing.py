"""What a campaign does not have of what effects and unnamed terms need."""

from __future__ import annotations

import numpy as np

from ..recording.command import Command
from .anonymous import Anonymous
from .evidence import CampaignEvidence
from .linear_device import TEMPERATURE_SPAN_K, span_k
from .monomials import WARM_FED
from .nuisance import SWITCHED
from .saturated import open_drive

__all__ = ["drive_changes", "missing_of", "needed_by"]

#: what an unnamed term needs, by what it depends on or by its form
_NEEDED = {"speed of change": {"open drive"}, "temperature": {"temperature"}, WARM_FED: {"warm open drive"}}


def needed_by(term: Anonymous) -> set[str]:
    """What an unnamed term needs, of what :func:`missing_of` may say."""
    return _NEEDED.get(term.depends_on, set()) | _NEEDED.get(term.form, set())


def drive_changes(command: Command) -> bool:
    """Whether a drive changes in a recording, by a side band or since it was switched: what is late or feeds through then shows."""
    return command.excitation.kind.endswith("modulation") or command.mode in SWITCHED


def missing_of(evidence: CampaignEvidence) -> set[str]:
    """What these recordings do not have, of what effects need.

    A resonance that answers the drive answers the drive's noise, and that follows the pick-off's where the loops are closed: without
    an open drive, side bands or a switched drive nothing tells a lag from it. A temperature that only wanders is the thermometer's noise.
    """
    told = open_drive(evidence)
    changed = any(drive_changes(r.recording.command) for r in evidence)
    open_k = [float(np.mean(r.signals.temperature_k)) for r in evidence if r.recording.command.excitation.kind == "drive"]
    there = {
        "open drive": told,
        "warm open drive": told and float(np.ptp(open_k)) >= TEMPERATURE_SPAN_K,
        "side bands": told or changed,
        "temperature": span_k(evidence) >= TEMPERATURE_SPAN_K,
    }
    return {name for name, yes in there.items() if not yes}
