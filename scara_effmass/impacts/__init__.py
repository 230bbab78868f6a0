# SPDX-License-Identifier: Apache-2.0
"""Impacts: found in the force signal. Pure: the same live and offline."""
