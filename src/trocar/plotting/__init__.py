"""Plots of recordings: joints against their set-points, errors, efforts."""

from trocar.plotting.plot import PlotReport, plot

__all__ = ["PlotReport", "plot"]
