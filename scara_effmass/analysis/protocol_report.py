# SPDX-License-Identifier: Apache-2.0
"""Report of a measurement protocol: a page that prints on A4, and the protocol as JSON."""

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from scara_effmass.analysis.force_traces import AFTER_S, ShownTrace, file_traces, shown
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.pages import PageOptions, file_hashes, render
from scara_effmass.analysis.protocol import Protocol
from scara_effmass.analysis.protocol_evaluation import overall, uncertainty
from scara_effmass.analysis.report import write_report_files
from scara_effmass.errors import EffmassError
from scara_effmass.settings import ImportSettings

PAGE, RECORD = "report.html", "report.json"


def check_report_folder(folder: Path, options: PageOptions, *, overwrite: bool) -> None:
    """Raise OutputError if a file of the report cannot be written into `folder`."""
    check_output_files(folder, [PAGE, RECORD, *options.files()], overwrite=overwrite)


def write_report(
    protocol: Protocol, path: Path, folder: Path, options: PageOptions, *, overwrite: bool
) -> dict[str, Any]:
    """Write the report of the evaluated `protocol` in the file at `path` into `folder`; return its record.

    Raises OutputError.
    """
    contacts = [item for test in protocol.tests for item in test.results.repetitions]
    data = [path.parent / item.raw_data for item in contacts if item.raw_data]
    photos = [path.parent / name for test in protocol.tests for name in test.results.photos or ()]
    devices = [(test, protocol.device(test)) for test in protocol.tests]
    page = render(
        "protocol.html",
        options.language,
        protocol=protocol,
        verdict=overall(protocol).name,
        running=protocol.identity.robot_model or path.name,
        simulated=any(item.simulated for item in contacts),
        traces=list(_traces(protocol, path.parent)),
        budgets=[(test.id, uncertainty(test, device) if device else None) for test, device in devices],
        files=file_hashes(Path(os.path.normpath(item)) for item in (path, *data, *photos)),
    )
    result = {"verdict": overall(protocol).name, **protocol.model_dump(mode="json")}
    texts = {PAGE: page, RECORD: json.dumps(result, indent=1, ensure_ascii=False) + "\n"}
    write_report_files(folder, texts, [], overwrite=overwrite, pdf_of=PAGE * options.pdf)
    return result


def _traces(protocol: Protocol, folder: Path) -> Iterator[ShownTrace]:
    """Yield the force of the contacts whose raw data can be read without further settings."""
    for test in protocol.tests:
        for number, item in enumerate(test.results.repetitions, start=1):
            if item.raw_data and item.time and item.transient_peak_n is not None:
                onset_ns = round(item.time.timestamp() * 1e6) * 1000
                offset_s = item.raw_offset_s or 0.0
                with suppress(EffmassError):
                    traces = file_traces(folder / item.raw_data, ImportSettings(), [onset_ns], AFTER_S, offset_s)
                    yield from shown(
                        f"{test.id}, {number}",
                        onset_ns,
                        traces[0],
                        simulated=bool(item.simulated),
                        peak=item.transient_peak_n,
                        predicted=item.predicted_force_n,
                        speed=item.reached_speed_m_s,
                    )
