"""Planners against a recorded world: open loop and closed loop."""
