# SPDX-License-Identifier: Apache-2.0
"""Studies on top of the product: the paper recomputed, simulated campaigns, and how far the verdicts can be trusted.

The paper: A. C., M. B., M. T., A. D. and G. R. (initials as in its author contributions; see CITATION.cff) on a
simplified lumped-parameter model of the effective mass, validated by impacts of an Omron i4-550L on a cart.

The paper: `scara` has the three models of the robot and the poses, `runs` reads the recordings, `claims` compares the
paper's numbers with ours, and `figures` draws and writes everything. `other_robot` draws the figures that another robot
can have.

Simulated experiments: `campaign` records the paper's experiment, `shipped_bags` what is in `bags/`. `bounds` simulates
contacts at the allowed speed, `evidence` random ones with a report, and `power` wrong campaigns; `lies` makes joint
states that deceive the monitor. `bounds`, `power`, `lies` and `shipped_bags` are commands:
`python -m scara_effmass.studies.power`.
"""

import argparse


def arguments_of(description: str | None, **defaults: float) -> argparse.Namespace:
    """Return the options of a study: numbers with these `defaults`, and --seed."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in {**defaults, "seed": 1}.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    return parser.parse_args()
