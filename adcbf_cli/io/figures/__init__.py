"""Pictures: one module a figure, whose `draw` turns its document into a matplotlib Figure. Of the reproduction, and of
a run (those that take their looks from `of_run`)."""
