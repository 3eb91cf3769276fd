"""treebake: bake a detailed tree mesh into billboard clouds, and prove how good the result is."""

from importlib.metadata import version

__version__ = version("treebake")
