"""``gyro-calib``: parse, run one command, turn its outcome into an exit code.

Exit codes: 0 done, 1 the data or the device does not allow it (the reason on stderr), 2 usage, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from ..errors import GyroCalibError
from ..threads import one_thread
from . import allan, blind_trial, calibrate, call, compare, demo, diagnose, factory, fleet, pickoff, simulate, study, up

__all__ = ["build_parser", "main"]

#: in the order in which a newcomer needs them
_COMMANDS = {
    "demo": demo,
    "up": up,
    "call": call,
    "simulate": simulate,
    "calibrate": calibrate,
    "diagnose": diagnose,
    "fleet": fleet,
    "compare": compare,
    "factory": factory,
    "pickoff": pickoff,
    "allan": allan,
    "study": study,
    "blind-trial": blind_trial,
}


def build_parser() -> argparse.ArgumentParser:
    """Parser of every command; each command's name, help and arguments stand in its module."""
    parser = argparse.ArgumentParser(prog="gyro-calib", description="Calibrate a Coriolis vibratory gyroscope without turning it.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, module in _COMMANDS.items():
        words = (module.__doc__ or "").strip().splitlines()[0].rstrip(".")
        command = commands.add_parser(name, help=words, description=module.__doc__, formatter_class=_Formatter)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    try:
        arguments = build_parser().parse_args(argv)
    except SystemExit as stop:  # argparse has already printed help or what is wrong
        return int(stop.code or 0)
    one_thread()
    try:
        return int(arguments.run(arguments))
    except GyroCalibError as error:
        print(f"gyro-calib {arguments.command}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # whoever read our output has enough; a second error at exit must not follow
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


class _Formatter(argparse.RawDescriptionHelpFormatter, argparse.ArgumentDefaultsHelpFormatter):
    """Description as written, defaults in the help."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        # "(default: None)" and "(default: False)" tell nobody anything
        if action.default in (None, False, argparse.SUPPRESS):
            return action.help
        return super()._get_help_string(action)
