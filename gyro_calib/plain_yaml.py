"""YAML of plain values, from anybody: one kind of error, whatever the text."""

from __future__ import annotations

from typing import Any

import yaml

__all__ = ["load_yaml"]

# what PyYAML raises on text that is not YAML, or is YAML of values that cannot be built (!!int x, 2024-99-99)
_NOT_YAML = (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses aliases: a few lines of them expand to gigabytes."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not allowed")
        return super().compose_node(parent, index)


def load_yaml(text: str) -> Any:
    """Value of a YAML text.

    Raises
    ------
    ValueError
        It is not YAML, or uses aliases; the text is one line that says why.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except _NOT_YAML as error:
        raise ValueError(" ".join(str(error).split())[:200]) from error
