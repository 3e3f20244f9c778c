"""Solvers of one planning step, found by name (`base.make_solver`)."""
