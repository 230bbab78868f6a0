"""Options of the commands, as arguments of `ArgumentParser.add_argument`."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from scara_effmass.settings import ContactType, MassModel


class Option(NamedTuple):
    """Arguments of `ArgumentParser.add_argument`."""

    names: tuple[str, ...]
    keywords: dict[str, Any]


def option(
    names: str,
    text: str,
    metavar: str | None = None,
    kind: Callable[[str], object] | None = None,
    **keywords: Any,  # noqa: ANN401 - those of add_argument
) -> Option:
    """Return the option or argument `names`, separated by a space, with its help `text`."""
    return Option(tuple(names.split()), {"help": text, "metavar": metavar, "type": kind, **keywords})


def flag(name: str, text: str, **keywords: Any) -> Option:  # noqa: ANN401 - those of add_argument
    """Return an option without a value."""
    return Option((name,), {"help": text, "action": "store_true", **keywords})


def params(nodes: str) -> Option:
    """Return --params, a parameter file that the other options override."""
    return option("--params", f"YAML file with the parameters of {nodes}", "FILE", Path)


def output(metavar: str, text: str) -> Option:
    """Return -o."""
    return option("-o --output", text, metavar, Path, required=True)


def number(rule: str, is_valid: Callable[[float], bool], kind: type[float] = float) -> Callable[[str], float]:
    """Return an argparse type: a number for which `is_valid` holds; `rule` says what it must be."""

    def parse(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not is_valid(value):
            raise argparse.ArgumentTypeError(f"{text}: must be {rule}")
        return value

    return parse


FORCE = flag("--force", "replace existing output")
JSON = flag("--json", "print the result as JSON")
BAGS = option("bags", "recording, or folder of recordings", "BAG", Path, nargs="+")
TOPIC = option("--topic", "topic of the joint states (default: joint_states, else the only one)")
ROBOT = (
    option("--robot", "robot: URDF or DH YAML (default: the shipped Omron i4-550L)", "FILE"),
    option(
        "--model",
        "effective mass that decides the verdict (default: lumped)",
        dest="effective_mass_model",
        choices=[model.value for model in MassModel],
    ),
)
LIMITS = (
    option(
        "--region",
        "body region that the robot can hit; may be repeated (default: all with a limit)",
        "NAME",
        dest="body_regions",
        action="append",
    ),
    option("--contact", "type of contact (default: transient)", choices=[contact.value for contact in ContactType]),
)
MASS = number("a number from 0.001 to 1000", lambda mass: 1e-3 <= mass <= 1e3)
REPEATED = "may be repeated (default: the paper's experiment)"
