# SPDX-License-Identifier: Apache-2.0
"""Import force and joint states from files of other programs."""

CSV_IMPORTER = "scara_effmass.importers.csv_file:open_csv"
IMPORTERS = {
    ".csv": CSV_IMPORTER,
    ".tsv": CSV_IMPORTER,
    ".txt": CSV_IMPORTER,
    ".tdms": "scara_effmass.importers.tdms_file:open_tdms",
}
"""Function that opens files with this suffix; its module is imported only when it is needed."""
BAG_IMPORTER = "scara_effmass.importers.wrench_topic:open_wrench_topic"
"""Function that opens all other paths, which must be bags."""
