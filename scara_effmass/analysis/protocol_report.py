# SPDX-License-Identifier: Apache-2.0
"""Report of a measurement protocol: a page that prints on A4, and the protocol as JSON."""

import os
from collections.abc import Iterator
from contextlib import suppress
from itertools import groupby
from pathlib import Path

from scara_effmass.analysis.force_traces import AFTER_S, ShownTrace, file_traces, shown
from scara_effmass.analysis.output import check_output_files
from scara_effmass.analysis.pages import PageOptions, file_hashes, render
from scara_effmass.analysis.protocol import Protocol
from scara_effmass.analysis.protocol_evaluation import record, uncertainty
from scara_effmass.analysis.report import write_report_files
from scara_effmass.errors import EffmassError
from scara_effmass.settings import ImportSettings

PAGE, RECORD = "report.html", "report.json"


def check_report_folder(folder: Path, options: PageOptions, *, overwrite: bool) -> None:
    """Raise OutputError if a file of the report cannot be written into `folder`."""
    check_output_files(folder, [PAGE, RECORD, *options.files()], overwrite=overwrite)


def write_report(protocol: Protocol, path: Path, folder: Path, options: PageOptions, *, overwrite: bool) -> None:
    """Write the report of the evaluated `protocol` in the file at `path` into `folder`. Raises OutputError."""
    content = record(protocol)
    contacts = [item for test in protocol.tests for item in test.results.repetitions]
    data = [path.parent / item.raw_data for item in contacts if item.raw_data]
    photos = [path.parent / name for test in protocol.tests for name in test.results.photos or ()]
    devices = [(test, protocol.device(test)) for test in protocol.tests]
    page = render(
        "protocol.html",
        options.language,
        protocol=protocol,
        verdict=content["verdict"],
        running=protocol.identity.robot_model or path.name,
        simulated=any(item.simulated for item in contacts),
        traces=list(_traces(protocol, path.parent)),
        budgets=[(test.id, uncertainty(test, device) if device else None) for test, device in devices],
        files=file_hashes(Path(os.path.normpath(item)) for item in (path, *data, *photos)),
    )
    pdf_of = PAGE if options.pdf else None
    write_report_files(folder, {PAGE: page, RECORD: content}, [], overwrite=overwrite, pdf_of=pdf_of)


def _traces(protocol: Protocol, folder: Path) -> Iterator[ShownTrace]:
    """Yield the force of the contacts whose raw data needs no further settings to be read."""
    for test in protocol.tests:
        items = [
            (f"{test.id}, {number}", round(item.time.timestamp() * 1e6) * 1000, item)
            for number, item in enumerate(test.results.repetitions, start=1)
            if item.raw_data and item.time and item.transient_peak_n is not None
        ]
        for (name, offset_s), group in groupby(items, lambda entry: (entry[2].raw_data, entry[2].raw_offset_s or 0.0)):
            contacts = list(group)  # of one file, so that it is read once
            with suppress(EffmassError):
                onsets_ns = [onset_ns for _, onset_ns, _ in contacts]
                traces = file_traces(folder / str(name), ImportSettings(), onsets_ns, AFTER_S, offset_s)
                for (title, onset_ns, item), trace in zip(contacts, traces, strict=True):
                    yield from shown(
                        title,
                        onset_ns,
                        trace,
                        simulated=bool(item.simulated),
                        peak=item.transient_peak_n or 0.0,
                        predicted=item.predicted_force_n,
                        speed=item.reached_speed_m_s,
                    )
