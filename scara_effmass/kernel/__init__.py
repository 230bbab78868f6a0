# SPDX-License-Identifier: Apache-2.0
"""Compiled kernel: the numbers of many joint states, or of one, by another way than the reference. Pure; SI units."""
