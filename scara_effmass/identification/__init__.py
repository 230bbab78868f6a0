# SPDX-License-Identifier: Apache-2.0
"""Masses from the motion and the torques of the joints."""
