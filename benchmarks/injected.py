"""What recordings of a device tell: every effect of the registry added to their equations, named; and unknown once the registry lacks it.

python benchmarks/injected.py FILE [--snr 40 100] [--seed 1] [--only NAME …]

The noise, the floors, the nuisances and the plan are those of the recordings, of whatever maker; the device should be healthy. An effect is
right when its group is the only one, unknown (the registry without it, and without what no campaign of this plan tells from it) when the
verdict would be. Its form is the diagnosis' own: that it is that of a device is for blind trials to say.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from gyro_calib.gap.heldout import shrinkage
from gyro_calib.gap.model import CampaignModel, look_at
from gyro_calib.gap.preflight import check_campaign, usable
from gyro_calib.gap.select import Selection, select_effects
from gyro_calib.recording.load import load_campaign
from gyro_calib.recording.recording import Campaign
from gyro_calib.trial.injected import with_effect
from gyro_calib.trial.labels import reported_name, trial_effects
from gyro_calib.trial.sizing import Sized, imitators, size_effect
from gyro_calib.trial.trial import LIKE


def looked_at(campaign: Campaign) -> CampaignModel:
    """A campaign, ready to be screened."""
    check_campaign(campaign)
    f = campaign.factory
    return look_at(usable(campaign), math.pi * f["nominal_f0_hz"] / f["nominal_q"], f["angular_gain_kappa"])


def judged(model: CampaignModel) -> tuple[Selection, bool]:
    """What is selected, and whether the verdict would be unknown."""
    selection = select_effects(model)
    unseen = shrinkage(model, [e.candidate for e in selection.effects])
    return selection, selection.stranger is not None or unseen.leaves_more


def tried(model: CampaignModel, sized: Sized) -> tuple[bool, bool, str]:
    """Whether an effect has its name, whether it is unknown without it, and what was said instead."""
    ill = with_effect(model, sized)
    selection, unknown = judged(ill)
    alike = [name for name, left in imitators(model, sized).items() if left < LIKE]
    names = {reported_name(sized.name), *alike}
    right = not unknown and len(selection.groups) == 1 and bool(names & set(selection.groups[0]))
    without, stranger = judged(replace(ill, candidates={n: c for n, c in ill.candidates.items() if n not in names}))
    said = [] if right else [f"named {_said(selection)}"]
    said += [] if stranger else [f"without it {_said(without)}"]
    return right, stranger, "; ".join(said)


def _said(selection: Selection) -> str:
    names = [e.name for e in selection.effects] + ([f"[{selection.stranger.term.name}]"] if selection.stranger is not None else [])
    return ", ".join(names) or "none"


def main() -> None:
    """A line for every effect that is not right, and the shares of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--snr", nargs="+", type=float, default=[40.0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", default=[])
    options = parser.parse_args()
    model = looked_at(load_campaign(options.file))
    healthy, unknown = judged(model)
    print(f"{options.file.name} as it is: {'unknown' if unknown else _said(healthy)}", flush=True)
    whole_angle = any(r.recording.command.mode == "whole_angle" for r in model.evidence)
    for snr in options.snr:
        right, strangers, of = 0, 0, 0
        for place, name in enumerate(
            n for n in trial_effects("whole-angle" if whole_angle else "force-rebalance") if not options.only or n in options.only
        ):
            sized = size_effect(model, name, snr, np.random.default_rng([options.seed, place]))
            if sized is None:
                continue
            good, stranger, said = tried(model, sized)
            right, strangers, of = right + good, strangers + stranger, of + 1
            if said:
                print(f"SNR {snr:g}  {name:28s} {said}", flush=True)
        print(f"SNR {snr:g}, {of} effects of fair size: {right} named, {strangers} unknown when the registry lacks them", flush=True)


if __name__ == "__main__":
    main()
