# SPDX-License-Identifier: Apache-2.0
"""What consumers do with verdicts: the status of a cell, speed scaling, re-timing. Pure: time is an argument."""
