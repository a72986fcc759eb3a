"""Innovations: gates, statistics, diagnosis of a source by its innovations."""
