"""A planner, a clusterer and a motion model for adcbf; `pyproject.toml` names them."""
