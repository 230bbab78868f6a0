# SPDX-License-Identifier: Apache-2.0
"""What a cell does with the verdicts. Pure."""
