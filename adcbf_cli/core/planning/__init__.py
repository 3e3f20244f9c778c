"""Planners: barriers, one optimal-control problem, solvers, the fallback ladder, baselines."""
