"""Pictures of blind trials: reliability curve and confusion matrix."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..trial.scores import confusion, reliability
from .theme import PAPER, Theme, figure

if TYPE_CHECKING:
    from ..trial.run import BlindTrials

__all__ = ["draw_trials"]


def draw_trials(result: BlindTrials, theme: Theme = PAPER) -> Any:
    """Probability against how often it was right, and truth against what was said.

    Raises
    ------
    DataError
        matplotlib is not installed.
    """
    with figure(theme, 1, 2) as (drawing, axes):
        _reliability(axes[0], result, theme)
        _confusion(axes[1], result, theme)
    return drawing


def _reliability(axis: Any, result: BlindTrials, theme: Theme) -> None:
    rows = [r for r in reliability(result.outcomes) if r["count"]]
    stated = np.array([r["stated"] for r in rows])
    right = np.array([r["right"] / r["count"] for r in rows])
    spread = np.array([r["interval"] for r in rows]).reshape(-1, 2)
    axis.plot([0.0, 1.0], [0.0, 1.0], color=theme.muted, linewidth=0.8, label="stated = true")
    if rows:
        error = np.abs(spread.T - right)
        axis.errorbar(stated, right, yerr=error, fmt="o-", color=theme.series[0], capsize=3.0, label="verdicts, 95 % interval")
    axis.set(
        xlim=(0.0, 1.02),
        ylim=(0.0, 1.02),
        xlabel="probability stated [1]",
        ylabel="share right [1]",
        title="Reliability: below the line, too sure",
    )
    axis.legend(loc="upper left")


def _confusion(axis: Any, result: BlindTrials, theme: Theme) -> None:
    table = confusion(result.outcomes)
    truths = list(table)
    said = [*truths, *sorted({name for row in table.values() for name in row} - set(truths))]
    counts = np.array([[table[t].get(s, 0) for s in said] for t in truths], dtype=float).reshape(len(truths), len(said))
    total = counts.sum(axis=1, keepdims=True)
    axis.imshow(counts / np.where(total > 0.0, total, 1.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axis.grid(False)
    axis.set_xticks(range(len(said)), said, rotation=90, fontsize=5)
    axis.set_yticks(range(len(truths)), truths, fontsize=5)
    axis.set(title="Share of each truth that was called so: darker is more", xlabel="said", ylabel="truth")
