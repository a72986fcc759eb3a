"""Theodolite pointing: axis errors, lines of sight, image, optical axis, calibration."""
