# SPDX-License-Identifier: Apache-2.0
"""Simulated robots and measurements.

`motion` plans moves of the paper's SCARA. `collision_sim` is MuJoCo with robot, cart and contact; `experiment` drives
the robot into the cart, and `measurement` turns that into joint states and force samples; `recordings` writes them as
bags. `plate_sim` lets any robot hit a free plate.
"""
