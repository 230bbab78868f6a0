"""A force recording in the unit of its file: what every importer returns."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from scara_effmass.errors import SettingsError
from scara_effmass.values import FloatArray

NEWTON_PER_UNIT = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665}
"""NIST SP 811, Appendix B.8."""
VOLT_PER_UNIT = {"V": 1.0, "mV": 1e-3}
UNITS = (*NEWTON_PER_UNIT, *VOLT_PER_UNIT)

BLOCK_TIME_S = 0.1
"""Length of an imported block."""


class SampleBlock(NamedTuple):
    """Consecutive samples (n,) from `stamp_ns` on.

    `clock_residual` [s] is the uncertainty of the stamp; `lost_samples` are missing right before the block.
    """

    stamp_ns: int
    samples: FloatArray
    lost_samples: int
    clock_residual: float


@dataclass(frozen=True, slots=True)
class ForceFile:
    """An open force recording with a constant `sample_rate` [Hz].

    `losses` returns one line for each part that could not be read so far; read it after `blocks`.
    """

    description: str
    unit: str
    """One of UNITS."""
    sample_rate: float
    blocks: Iterator[SampleBlock]
    simulated: bool = False
    losses: Callable[[], tuple[str, ...]] = tuple


def select_unit(setting: str, stated: str, origin: str) -> str:
    """Return the unit that the setting or the file states; either may be empty.

    Raises SettingsError when neither states one of UNITS, or when they differ.
    """
    choices = ", ".join(UNITS)
    if not setting and not stated:
        raise SettingsError(f"{origin}: states no unit; unit must be one of {choices}")
    if not setting and stated not in UNITS:
        raise SettingsError(f"{origin}: has the unit {stated!r}; convert it, or set unit to one of {choices}")
    if setting and stated in UNITS and stated != setting:
        raise SettingsError(f"{origin}: unit = {setting}: must be empty, the file states {stated}")
    return setting or stated
