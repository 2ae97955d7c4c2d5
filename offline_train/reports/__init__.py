"""Plots, model cards and evaluation reports: the same figures give the same bytes."""
