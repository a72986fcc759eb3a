"""Alerts of a suite: their situations, states and priorities."""
