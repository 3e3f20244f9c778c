"""The reproduction's pictures: one module a figure, whose `draw` turns its document into a matplotlib Figure."""
