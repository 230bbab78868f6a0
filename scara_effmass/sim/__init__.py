"""The simulated cell: robot, cart and force sensor in MuJoCo, and the generator of the reference recordings."""
