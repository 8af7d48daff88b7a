"""All that is asked of recordings before anything is fitted, in order: what each says by itself, then what they say of each other."""

from __future__ import annotations

from ..recording.recording import Campaign, Recording
from .commanded import check_commanded
from .odd_one_out import check_alike
from .one_clock import on_one_clock
from .one_device import check_one_device, said_of_reference
from .preflight import check_campaign, usable

__all__ = ["checked"]


def checked(campaign: Campaign, angular_gain: float, decay_rate: float) -> tuple[list[Recording], list[str]]:
    """Recordings that can be used, on one clock, and lines on what does a verdict no harm.

    Parameters
    ----------
    campaign : Campaign
    angular_gain : float
        kappa of the factory.
    decay_rate : float
        1/tau of the factory [1/s].

    Raises
    ------
    DataError
        What contradicts itself: names the recording, the value and the remedy.
    """
    warnings = check_campaign(campaign)
    recordings, said = on_one_clock(usable(campaign))
    warnings += [*said, *said_of_reference(recordings, campaign.factory)]
    check_one_device(recordings)
    check_commanded(recordings, decay_rate)
    check_alike(recordings, angular_gain)
    return recordings, warnings
