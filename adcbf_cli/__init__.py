"""adcbf: turn recorded robot logs into tracked, predicted and scored obstacles."""

__version__ = "0.1.0"
