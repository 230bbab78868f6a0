"""The paper's figures and numbers anew, from this project's own models and recordings.

Bottom up: `scara` the robot and its three models, `workspace` where they are evaluated, `motion` and `recorded_impact`
what was recorded; a module per kind of figure; `*_claims` the paper's numbers beside ours; `album` all together.
"""
