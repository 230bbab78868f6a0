# SPDX-License-Identifier: Apache-2.0
"""Effective mass of a serial robot at a contact point. Pure; SI units.

`lumping` builds the simplified model; the formula (Eqs. 3-14) is in `reference.dynamics`, the closed forms of the
SCARA are in `studies.scara`.
"Eq. N", "Fig. N" and "Table N" are those of the paper cited in README.md and CITATION.cff, an article on the effective
mass and the impact force of an Omron i4-550L SCARA. The operational space formulation behind it: O. Khatib, "A unified
approach for motion and force control of robot manipulators: The operational space formulation", IEEE Journal on
Robotics and Automation 3(1), 43-53, 1987, doi 10.1109/JRA.1987.1087068.
"""
