# SPDX-License-Identifier: Apache-2.0
"""A force recording of another program: its unit, and its samples as blocks of uniform sampling.

A sensor measures at a constant rate, but stamps jitter or come in bursts, and samples may be missing. A delayed sample
shifts only its own stamp; a missing sample shifts all stamps after it. The minimum delay within a window of samples
tells the two apart.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from scara_effmass.errors import BagError, SettingsError
from scara_effmass.settings import ImportSettings
from scara_effmass.values import FloatArray, ForceBlock
from scara_effmass.wire.cdr import NS

IntArray = NDArray[np.int64]

NEWTON_PER_UNIT = {"N": 1.0, "kN": 1e3, "daN": 10.0, "lbf": 4.4482216152605, "kgf": 9.80665}
"""NIST SP 811, Appendix B.8."""
VOLT_PER_UNIT = {"V": 1.0, "mV": 1e-3}
SPELLINGS = {"newton": "N", "newtons": "N", "kilonewton": "kN", "kilonewtons": "kN", "volt": "V", "volts": "V"}
SPELLINGS |= {"second": "s", "seconds": "s", "millisecond": "ms", "milliseconds": "ms"}
SPELLINGS |= {"microsecond": "us", "microseconds": "us", "nanosecond": "ns", "nanoseconds": "ns"}
SPELLINGS |= {"secs": "s", "msec": "ms", "msecs": "ms", "usec": "us", "usecs": "us", "nsec": "ns", "nsecs": "ns"}
SPELLINGS |= {"sekunden": "s", "millisekunden": "ms", "mikrosekunden": "us", "nanosekunden": "ns"}
"""Other spellings of units, in lower case."""
FORCE_NAME = re.compile(r"force|kraft|kräfte|\b(?:f[xyz]?\d*|load|last)\b")
"""What names a column or channel of force, in lower case, with spaces for underscores."""
NOT_MEASURED = re.compile(r"\b(?:target|set ?point|desired|command|cmd|ref|reference|limit|max|min|soll)")
"""What names a column or channel that states a force but does not measure it, likewise."""
UNITS = (*NEWTON_PER_UNIT, *VOLT_PER_UNIT)

TABLE_SETTINGS = ("rate", "time_column", "header")
"""Settings without effect on messages."""
MIN_RATE, MAX_RATE = 20.0, 1e5
"""Rates of force [Hz] between which times without a unit are in seconds; beyond, they are milliseconds or days."""
MIN_SAMPLES = 10
"""Number of samples in which no impact is found, so that their rate does not matter."""
BLOCK_TIME_S = 0.1
"""Length of an imported block."""
HEAD = 4096
"""Number of samples that determine the rate."""
CHUNK = 4096
"""Number of samples that are numbered at a time."""
WINDOW = 64
"""Number of samples whose minimum delay is compared with that of the samples before them."""
MAX_BURST = WINDOW // 2
"""Number of samples that may have the same time; with more, the windows do not show the rate."""
LAGS = (1, 4, 16, 64, 256, 1024)
STEP_TOLERANCE, MIN_EVEN_STEPS = 0.25, 0.75
"""Stamps are no bursts if this share of the steps (MIN_EVEN_STEPS) deviates by less than this share of the period."""
EVEN_RUN, EVEN_TOLERANCE = 16, 0.1
"""So many steps that differ by at most this share of the least, at up to MAX_RATE, are no burst, which jitters."""
NOISE_FACTOR = 2.0
"""The delays of two windows without a gap rarely differ by more than this multiple of the usual delay."""
BURST_ROUNDS = 4
MAX_LOSS = 0.5


@dataclass(frozen=True, slots=True)
class ForceFile:
    """An open force recording with a constant `sample_rate` [Hz].

    `blocks` are in `unit` and without origin; lost samples show in their sample numbers. `losses` returns one line for
    each part that could not be read so far; call it after reading `blocks`.
    """

    description: str
    unit: str
    """One of UNITS."""
    sample_rate: float
    blocks: Iterator[ForceBlock]
    simulated: bool = False
    losses: Callable[[], tuple[str, ...]] = tuple


def short_unit(unit: str) -> str:
    """Return a unit, short if it is spelled out."""
    return SPELLINGS.get(unit.lower(), unit)


def is_force_name(name: str) -> bool:
    """Return whether a column or channel has a name of force."""
    return FORCE_NAME.search(_words(name)) is not None


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def select_force(path: Path, channels: Sequence[tuple[str, str]], remedy: str = "") -> str:
    """Return the only one of the columns or channels, given by name and stated unit, that can be force.

    Those that are named force have priority, whatever their unit is; else those with a unit of force, but volts only if
    no other one is without a unit. Beside a set point or limit, all with a unit of force count. Raises SettingsError if
    several remain.
    """
    candidates = [name for name, _ in channels if is_force_name(name)]
    if any(NOT_MEASURED.search(_words(name)) for name in candidates):
        candidates = [name for name, unit in channels if name in candidates or unit in NEWTON_PER_UNIT]
    if not candidates:
        has_force = any(unit in NEWTON_PER_UNIT for _, unit in channels)
        candidates = [name for name, unit in channels if unit in UNITS or not (unit or has_force)]
    candidates = candidates or [name for name, _ in channels]
    if len(candidates) == 1:
        return candidates[0]
    raise SettingsError(f"{path}: topic is empty: must be one of {', '.join(candidates)}{remedy}")


def select_unit(setting: str, stated: str, origin: str) -> str:
    """Return the unit stated by the setting or by the file; either may be empty.

    Raises SettingsError if neither is one of UNITS, or if they differ.
    """
    choices = f"--unit, one of {', '.join(UNITS)}"
    if not setting and not stated:
        raise SettingsError(f"{origin}: states no unit; state {choices}")
    if not setting and stated not in UNITS:
        raise SettingsError(f"{origin}: has the unit {stated!r}; convert it, or state {choices}")
    if setting and stated in UNITS and stated != setting:
        raise SettingsError(f"{origin}: unit = {setting}: must be empty, the file states {stated}")
    return setting or stated


def check_seconds(sample_rate: float, count: int, origin: str, remedy: str) -> None:
    """Raise BagError, with a `remedy`, if the times of `count` samples, without a unit, can hardly be in seconds.

    In more than MIN_SAMPLES, an impact would be found whose impulse is wrong.
    """
    if count > MIN_SAMPLES and not MIN_RATE <= sample_rate <= MAX_RATE:
        problem = f"states no unit, and in seconds the rate would be {sample_rate:.4g} Hz"
        raise BagError(f"{origin}: {problem}; must state the unit: {remedy}")


def refuse_settings(settings: ImportSettings, names: Iterable[str], origin: str, reason: str) -> None:
    """Raise SettingsError if one of the settings `names` ("sensor.invert") is stated, although it has no effect."""
    for name in names:
        value, default = (attrgetter(name)(item) for item in (settings, ImportSettings()))
        if value != default:
            raise SettingsError(f"{origin}: {name} = {value}: must not be stated, {reason}")


class _Sampling(NamedTuple):
    """Sampling period, and the steps of the delay [ns] that show a gap: normally, and near the end of the samples."""

    period_ns: float
    threshold_ns: float
    short_threshold_ns: float


def uniform_samples(origin: str, stamps_ns: IntArray, values: FloatArray) -> tuple[float, Iterator[ForceBlock]]:
    """Return the rate [Hz] and blocks of `values` (n,) with ascending stamps (n,) [ns]; `origin` begins errors.

    A block ends before a gap. Each stamp in a block gives an estimate of the time of its first sample; their median is
    the stamp of the block, and their RMS deviation from it is the `clock_residual`. Raises BagError if the rate is not
    constant.
    """
    if len(stamps_ns) < 2:
        raise BagError(f"{origin}: has {len(stamps_ns)} samples; must have at least 2")
    burst = len(stamps_ns) / (1 + np.count_nonzero(np.diff(stamps_ns)))
    if burst > MAX_BURST:
        raise BagError(f"{origin}: has {burst:.0f} samples with the same time: must have at most {MAX_BURST}")
    try:
        sampling = _sampling(stamps_ns[:HEAD])
        _check_rate(stamps_ns, sampling.period_ns)
    except ValueError as error:
        raise BagError(f"{origin}: {error}") from None
    return NS / sampling.period_ns, _blocks(stamps_ns, values, sampling)


def _check_rate(stamps_ns: IntArray, period_ns: float) -> None:
    """Raise ValueError if a part longer or more even than a burst has a rate above that of the period."""
    for size, tolerance, min_ns in ((WINDOW, 2.0 * STEP_TOLERANCE, 1.0), (EVEN_RUN, EVEN_TOLERANCE, NS / MAX_RATE)):
        if len(stamps_ns) <= size:
            continue
        steps_ns = sliding_window_view(np.diff(stamps_ns), size)[:: size // 4]
        least_ns, largest_ns = steps_ns.min(axis=1), steps_ns.max(axis=1)
        is_even = (least_ns >= min_ns) & (largest_ns - least_ns <= tolerance * least_ns)
        faster = np.flatnonzero(is_even & (largest_ns < (1.0 - STEP_TOLERANCE) * period_ns))
        if len(faster):
            first = int(faster[0]) * (size // 4)
            rate, start_s = NS / np.median(steps_ns[faster[0]]), (stamps_ns[first] - stamps_ns[0]) / NS
            rates = f"{rate:.6g} Hz from {start_s:.3f} s on, {NS / period_ns:.6g} Hz on average"
            raise ValueError(f"has no constant rate: {rates}: must be one in a file")


def _blocks(stamps_ns: IntArray, values: FloatArray, sampling: _Sampling) -> Iterator[ForceBlock]:
    numbers = _sample_numbers(stamps_ns, sampling)
    for start, stop in pairwise([0, *(np.flatnonzero(np.diff(numbers) > 1) + 1).tolist(), len(numbers)]):
        for block in split(int(numbers[start]), 0, values[start:stop], NS / sampling.period_ns):
            first = start + block.first_sample - int(numbers[start])
            part_ns = stamps_ns[first : first + len(block.force)]
            deviation_ns = _delay_ns(part_ns, sampling.period_ns)
            shift_ns = float(np.median(deviation_ns))
            residual_ns = float(np.sqrt(np.mean((deviation_ns - shift_ns) ** 2)))
            yield block._replace(stamp_ns=int(part_ns[0]) + round(shift_ns), clock_residual=residual_ns / NS)


def split(first_sample: int, stamp_ns: int, values: FloatArray, sample_rate: float) -> Iterator[ForceBlock]:
    """Yield `values` (n,) without a gap, of which the first one is at `stamp_ns`, as blocks of BLOCK_TIME_S."""
    size = max(1, round(BLOCK_TIME_S * sample_rate))
    for first in range(0, len(values), size):
        block_ns = stamp_ns + round(first / sample_rate * NS)
        yield ForceBlock(block_ns, "", first_sample + first, sample_rate, values[first : first + size])


def _sample_numbers(stamps_ns: IntArray, sampling: _Sampling) -> IntArray:
    """Return the number of each sample; missing samples count."""
    count = len(stamps_ns)
    numbers = np.arange(count)
    missing = 0
    for first in range(0, count, CHUNK):
        stop = min(first + CHUNK, count)
        # The samples around a chunk show whether its samples are late or follow a gap.
        begin, end = max(0, first - WINDOW), min(stop + WINDOW, count)
        numbers[first:end] = np.arange(first, end) + missing
        delay_ns = (stamps_ns[begin:end] - stamps_ns[0]) - numbers[begin:end] * sampling.period_ns
        threshold_ns = np.full(end - begin, sampling.threshold_ns)
        threshold_ns[max(0, count - WINDOW // 2 - begin) :] = sampling.short_threshold_ns
        at = first - begin
        while len(gaps := np.flatnonzero((_delay_steps(delay_ns) > threshold_ns)[at : stop - begin])):
            at += int(gaps[0])
            lost = round(_delay_steps(delay_ns)[at] / sampling.period_ns)
            numbers[begin + at : end] += lost
            delay_ns[at:] -= lost * sampling.period_ns
            missing += lost
            at += 1
    return numbers


def _delay_steps(delay_ns: FloatArray) -> FloatArray:
    """Return the increase of the minimum delay from the window before each sample to the window that begins with it."""
    infinite = np.full(WINDOW, np.inf)
    minimum = sliding_window_view(np.concatenate((infinite, delay_ns, infinite)), WINDOW).min(axis=1)
    steps: FloatArray = minimum[WINDOW : WINDOW + len(delay_ns)] - minimum[: len(delay_ns)]
    return steps


def _sampling(stamps_ns: IntArray) -> _Sampling:
    """Determine the sampling; most of the samples must be present."""
    period_ns = _rough_period_ns(stamps_ns)
    if period_ns <= 0.0:
        raise ValueError("its times do not advance; must be times at a constant rate")
    windows_ns = _windows(_delay_ns(stamps_ns, period_ns), max(2, min(WINDOW, len(stamps_ns)) // 4))
    min_ns = windows_ns.min(axis=1)
    usual_ns = float(np.median(np.median(windows_ns, axis=1) - min_ns))
    max_ns = float(np.median(windows_ns.max(axis=1) - min_ns))
    threshold_ns = max(0.5 * (period_ns + usual_ns), NOISE_FACTOR * usual_ns)
    sampling = _Sampling(period_ns, threshold_ns, 0.5 * period_ns + NOISE_FACTOR * max_ns)
    numbers = _sample_numbers(stamps_ns, sampling)
    half = len(stamps_ns) // 2
    period_ns = float(np.mean(stamps_ns[half:] - stamps_ns[:-half]) / np.mean(numbers[half:] - numbers[:-half]))
    total = int(numbers[-1]) + 1
    missing = total - len(stamps_ns)
    gaps = np.count_nonzero(np.diff(numbers) > 1)
    if missing > MAX_LOSS * total and gaps * WINDOW > len(stamps_ns):  # not in a few pauses
        raise ValueError(f"has no constant rate: of {total} samples at {NS / period_ns:.6g} Hz, {missing} are missing")
    return sampling._replace(period_ns=period_ns)


def _rough_period_ns(stamps_ns: IntArray) -> float:
    """Return the sampling period, accurate enough to detect gaps."""
    steps_ns = np.diff(stamps_ns)
    period_ns = float(np.median(steps_ns))
    half = len(stamps_ns) // 2
    is_even = np.mean(np.abs(steps_ns - period_ns) <= STEP_TOLERANCE * period_ns) >= MIN_EVEN_STEPS
    if is_even and 0.0 < (1.0 - MAX_LOSS) * np.mean(steps_ns) <= period_ns:
        # The period from a shorter lag gives the number of periods in a longer one, including missing samples.
        for lag in (lag for lag in LAGS if lag <= half):
            spans_ns = stamps_ns[lag:] - stamps_ns[:-lag]
            period_ns = float(spans_ns.sum() / np.round(spans_ns / period_ns).sum())
        return period_ns
    # In bursts, compare the least delayed sample of each window with that of the next window.
    lag = min(WINDOW, half)
    period_ns = float(np.median(stamps_ns[lag:] - stamps_ns[:-lag])) / lag
    for _ in range(BURST_ROUNDS if half >= WINDOW else 0):
        earliest = _windows(_delay_ns(stamps_ns, period_ns), WINDOW).argmin(axis=1)
        earliest += np.arange(len(earliest)) * WINDOW
        period_ns = float(np.median(np.diff(stamps_ns[earliest]) / np.diff(earliest)))
    return period_ns


def _delay_ns(stamps_ns: IntArray, period_ns: float) -> FloatArray:
    """Return the delay of each sample relative to the first one, for samples without a gap."""
    delay_ns: FloatArray = (stamps_ns - stamps_ns[0]) - np.arange(len(stamps_ns)) * period_ns
    return delay_ns


def _windows(values: FloatArray, size: int) -> FloatArray:
    """Return consecutive windows (k, size); the remainder is left out."""
    return values[: len(values) // size * size].reshape(-1, size)
