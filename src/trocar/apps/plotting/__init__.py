"""Draw recordings: joints against their set-points, errors, efforts."""

from trocar.apps.plotting.draw import PlotReport, plot

__all__ = ["PlotReport", "plot"]
