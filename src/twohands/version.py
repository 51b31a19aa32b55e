"""The package's version, alone: who writes it into a file need not import the package's public names."""

__version__ = "0.1.0"
