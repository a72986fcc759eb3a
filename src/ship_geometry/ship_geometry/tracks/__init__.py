"""Tracks of samples, with interpolation between the samples and its error."""
