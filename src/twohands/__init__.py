"""Both hands in metres, from one plain RGB camera."""

__version__ = "0.1.0"
