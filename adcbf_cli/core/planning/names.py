"""The built-in planners' names, for those who must not wait for the planners themselves to be imported."""

from __future__ import annotations

PLANNER_NAMES = (
    *("mpc-dc", "mpc-cbf", "d-cbf-mpc", "a-cbf-mpc", "ad-cbf-mpc", "od-ad-cbf-mpc"),
    *("dwa", "apf", "pure-pursuit"),
)
"""As in `presets.PLANNERS`; a test holds them to it."""
