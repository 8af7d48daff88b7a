"""Validation shared by the device descriptions."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

from ..errors import DeviceError

__all__ = ["require_finite", "require_non_negative", "require_positive"]


def require_finite(instance: Any) -> None:
    """Raise :class:`DeviceError` when a numeric field of a dataclass is not a finite number."""
    for field in fields(instance):
        value = getattr(instance, field.name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if not math.isfinite(value):
            raise DeviceError(f"{type(instance).__name__} {field.name} must be finite, but got {value!r}.")


def require_positive(instance: Any, *names: str) -> None:
    """Raise :class:`DeviceError` when a named field is not > 0."""
    for name in names:
        value = getattr(instance, name)
        if not value > 0:
            raise DeviceError(f"{type(instance).__name__} {name} must be > 0, but got {value!r}.")


def require_non_negative(instance: Any, *names: str) -> None:
    """Raise :class:`DeviceError` when a named field is negative."""
    for name in names:
        value = getattr(instance, name)
        if value < 0:
            raise DeviceError(f"{type(instance).__name__} {name} must be >= 0, but got {value!r}.")
