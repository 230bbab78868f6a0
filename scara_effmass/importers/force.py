# SPDX-License-Identifier: Apache-2.0
"""Convert force recordings of other programs to ForceBlocks, one by one or in a bag."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from pkgutil import resolve_name

import numpy as np

from scara_effmass.bags.bag import Bag
from scara_effmass.bags.files import open_bag
from scara_effmass.bags.writer import BagWriter
from scara_effmass.errors import BagError, SettingsError
from scara_effmass.impacts.detector import finite_parts
from scara_effmass.importers.force_file import NEWTON_PER_UNIT, VOLT_PER_UNIT, ForceFile, refuse_settings
from scara_effmass.importers.wrench_topic import read_wrench_topic
from scara_effmass.settings import ImportSettings
from scara_effmass.values import RANGE_TOLERANCE, ForceBlock
from scara_effmass.wire.cdr import NS
from scara_effmass.wire.force import force_block_message
from scara_effmass.wire.message_types import FORCE_BLOCK

MAX_VALUE = 1e9
"""[N] or [V]; no sensor measures more."""
OF_VOLTAGES = ("sensor.sensitivity", "sensor.sensitivity_uncertainty")
"""Settings without effect on values in a unit of force."""


@dataclass(slots=True)
class ImportedTopic:
    """Content of one imported topic, with the stamps of its first and last sample."""

    file: str
    topic: str
    source: str
    sample_rate_hz: float
    samples: int = 0
    lost_samples: int = 0
    saturated_samples: int = 0
    first_stamp_s: float = 0.0
    last_stamp_s: float = 0.0
    losses: tuple[str, ...] = ()


TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".asc", ".dat", ".prn", ".log")
IMPORTERS = dict.fromkeys(TEXT_SUFFIXES, "scara_effmass.importers.csv_file:open_csv") | {
    ".tdms": "scara_effmass.importers.tdms_file:open_tdms",
    ".lvm": "scara_effmass.importers.lvm_file:open_lvm",
}
"""Function that opens files with this suffix, imported when it is needed; all other paths must be bags."""


def import_force(path: Path, settings: ImportSettings) -> tuple[ForceFile, Iterator[ForceBlock]]:
    """Open a CSV, TDMS or LVM file, or a topic of wrenches or numbers in a bag; return it, and its force in newtons.

    Values that are not finite numbers count as lost samples. Raises BagError or SettingsError.
    """
    if (opener := IMPORTERS.get(path.suffix.lower())) is None:
        with open_bag(path) as bag:
            return import_wrenches(bag, settings)
    file: ForceFile = resolve_name(opener)(path, settings)
    ends: list[str] = []
    blocks = _force_blocks(path, file, settings, lambda line: ends.append(f"{path}: {line}"))
    return replace(file, losses=lambda: (*file.losses(), *ends)), blocks


def import_wrenches(bag: Bag, settings: ImportSettings) -> tuple[ForceFile, Iterator[ForceBlock]]:
    """Do the same with a topic of wrenches or numbers in an open bag."""
    file = read_wrench_topic(bag, settings)
    return file, _force_blocks(bag.path, file, settings, bag.add_loss)


def write_force_bag(
    paths: Sequence[Path], output: Path, settings: ImportSettings, *, overwrite: bool = False
) -> tuple[ImportedTopic, ...]:
    """Write the force in `paths` to a new bag, and return a summary of each topic.

    The first file is on the topic force, the next ones are on force/file1, force/file2 and so on. Raises BagError,
    SettingsError or OutputError; no incomplete bag remains.
    """
    with BagWriter(output, overwrite=overwrite) as bag:
        return tuple(
            _write_topic(bag, f"/force/file{number}" if number else "/force", path, settings)
            for number, path in enumerate(paths)
        )


def _write_topic(bag: BagWriter, topic: str, path: Path, settings: ImportSettings) -> ImportedTopic:
    file, blocks = import_force(path, settings)
    content = ImportedTopic(str(path), topic, file.description, file.sample_rate)
    for block in blocks:
        last_ns = block.stamp_ns + round((len(block.force) - 1) / block.sample_rate * NS)
        bag.write(topic, FORCE_BLOCK, max(0, last_ns), force_block_message(block))
        content.first_stamp_s = content.first_stamp_s if content.samples else block.stamp_ns / NS
        content.last_stamp_s = last_ns / NS
        content.samples += len(block.force)
        content.lost_samples += block.lost_samples
        content.saturated_samples += len(block.saturated_samples)
    content.losses = file.losses()
    return content


def _force_blocks(
    path: Path, file: ForceFile, settings: ImportSettings, add_loss: Callable[[str], object]
) -> Iterator[ForceBlock]:
    """Yield the finite samples in newtons, compression positive; a block ends before a sample that is not finite.

    `add_loss` receives a line about samples before the first and after the last one.
    """
    sensor = settings.sensor
    is_voltage = file.unit in VOLT_PER_UNIT
    unit_scale = VOLT_PER_UNIT[file.unit] if is_voltage else NEWTON_PER_UNIT[file.unit]
    newton_scale = (1e3 / sensor.sensitivity if is_voltage else 1.0) * (-1.0 if sensor.invert else 1.0)
    if is_voltage and "sensitivity" not in sensor.model_fields_set:
        rule = f"must be stated for values in {file.unit}: --sensitivity MV_PER_N, from the sensor's certificate"
        raise SettingsError(f"{path}: sensor.sensitivity: {rule}")
    if not is_voltage:
        refuse_settings(settings, OF_VOLTAGES, str(path), f"the values are in {file.unit}")
    saturation = sensor.range * (1.0 - RANGE_TOLERANCE)
    begin = end = total = 0
    for block in file.blocks:
        total = block.first_sample + len(block.force)
        with np.errstate(over="ignore", invalid="ignore"):  # damaged files hold huge numbers and signalling NaN
            values = block.force * unit_scale
            force = np.where(np.abs(values) <= MAX_VALUE, values * newton_scale, np.nan)
        force.flags.writeable = False
        for part in finite_parts(block._replace(force=force)):
            yield part._replace(
                frame_id=settings.frame_id,
                lost_samples=part.first_sample - end,
                saturated_samples=np.flatnonzero(np.abs(part.force) >= saturation).astype(np.uint32),
                source=file.description,
                simulated=file.simulated,
                # For a file in newtons, the sensor is unknown.
                relative_uncertainty=sensor.sensitivity_uncertainty if is_voltage and not file.simulated else 0.0,
            )
            begin = begin if end else part.first_sample
            end = part.first_sample + len(part.force)
    if not end:
        raise BagError(f"{path}: {file.description}: has no finite sample")
    if begin or total > end:
        add_loss(f"the first {begin} and the last {total - end} samples are no numbers")
