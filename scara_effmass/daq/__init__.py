# SPDX-License-Identifier: Apache-2.0
"""Where measured force comes from, and what is done with the signal until it is newtons with a time."""
