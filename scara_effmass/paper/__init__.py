# SPDX-License-Identifier: Apache-2.0
"""The paper's figures and claims, recomputed from this project's models and recordings.

The paper: A. C., M. B., M. T., A. D. and G. R. (initials as in its author contributions; see CITATION.cff) on a
simplified lumped-parameter model of the effective mass, validated by impacts of an Omron i4-550L on a cart.

`scara` has the three models of the robot and the poses, `runs` reads the recordings, `claims` compares the paper's
numbers with ours, `maps`, `density` and `experiment` draw the figures, and `figure_set` writes everything.
`other_robot` draws the figures that another robot can have.
"""
