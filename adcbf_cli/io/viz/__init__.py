"""Logs to look at: what a run folder holds, for Foxglove, RViz and Rerun.

    tables, log --scenes--> records --items--> what is drawn --> viz.foxglove.mcap
                                                             --> viz.ros2.mcap
                                                             --> viz.rrd

Streaming, in the order of time: what is held does not grow with the log.
"""

VIEW_FILES: dict[str, tuple[str, ...]] = {
    "foxglove": ("viz.foxglove.mcap", "viz.foxglove-layout.json"),
    "ros2": ("viz.ros2.mcap", "viz.rviz"),
    "rrd": ("viz.rrd",),
}
"""By format, what is written into the run folder: the log, and what tells the viewer how to show it."""
