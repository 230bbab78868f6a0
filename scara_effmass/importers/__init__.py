# SPDX-License-Identifier: Apache-2.0
"""Import force and joint states from files of other programs."""
