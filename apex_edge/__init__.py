"""APEX Edge: anticipatory safety for cheap robot arms."""

__version__ = "0.1.0"
