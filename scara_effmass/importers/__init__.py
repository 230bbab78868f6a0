# SPDX-License-Identifier: Apache-2.0
"""Force from the files of other programs, converted to ForceBlocks."""

CSV_IMPORTER = "scara_effmass.importers.csv_file:open_csv"
IMPORTERS = {
    ".csv": CSV_IMPORTER,
    ".tsv": CSV_IMPORTER,
    ".txt": CSV_IMPORTER,
    ".tdms": "scara_effmass.importers.tdms_file:open_tdms",
}
"""Function that opens files with a suffix; its module is imported when it is needed."""
BAG_IMPORTER = "scara_effmass.importers.wrench_topic:open_wrench_topic"
"""Function that opens anything else, which must be a bag."""
