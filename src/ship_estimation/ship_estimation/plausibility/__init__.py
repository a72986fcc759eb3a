"""Plausibility checks of samples before they reach a filter: frozen values, jumps, steps, rates, noise."""
