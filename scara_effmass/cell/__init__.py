# SPDX-License-Identifier: Apache-2.0
"""What consumers do with verdicts: the status of a cell, and the speed scaling. Pure: time is an argument."""
