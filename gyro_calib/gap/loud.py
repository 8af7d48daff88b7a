"""Recordings that are louder than others of their kind: what happened in one of them alone has no form, and is no noise either."""

from __future__ import annotations

from dataclasses import dataclass

from ..recording.applied_rate import is_turned
from .diagnosis import Unknown
from .evidence import CHANNELS
from .model import CampaignModel

__all__ = ["Loud", "loudest"]

#: power over that of its kind from which on a recording is not of its kind; those of some forty healthy campaigns came to 4.4
_LOUD = 8.0


@dataclass(frozen=True)
class Loud:
    """A recording that no model follows.

    Parameters
    ----------
    label, channel : str
    ratio : float
        Power of what is left over the noise of its kind.
    equations : int
        Of that channel.
    """

    label: str
    channel: str
    ratio: float
    equations: int

    def warning(self) -> str:
        """For the reader of any verdict."""
        return (
            f"Recording {self.label} holds {self.ratio:.0f} times the noise of its kind ({self.channel}), and nothing here has its form. "
            "Record it again: what comes back is of the device, what does not was a disturbance."
        )

    def unknown(self) -> Unknown:
        """As a finding."""
        form = f"what recording {self.label} alone holds ({self.channel}, {self.ratio:.0f} times the noise of its kind)"
        return Unknown("environment", "phase not told", form, "recording", "", self.ratio * self.equations)


def loudest(model: CampaignModel) -> Loud | None:
    """The loudest recording, if one is not of its kind; not of a rate table, which does things besides its log."""
    found = [
        Loud(r.recording.label, channel, model.excess[r.index, channel], r.signal.lhs.size)
        for r in model.evidence
        for channel in CHANNELS
        if model.excess.get((r.index, channel), 0.0) > _LOUD and not is_turned(r.recording)
    ]
    return max(found, key=lambda loud: loud.ratio, default=None)
