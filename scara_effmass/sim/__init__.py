"""Where motion comes from when there is no robot: paths, inverse kinematics, recordings. Knows nothing of masses."""
