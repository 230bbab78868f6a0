# SPDX-License-Identifier: Apache-2.0
"""The simulated cell: robot, cart and force sensor in MuJoCo, and the generator of the reference recordings."""
