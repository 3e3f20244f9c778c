"""Vehicle models: kinematics, limits, braking."""
