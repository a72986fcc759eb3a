"""A simulated theodolite whose calibration telescope sees the lights of drones, models.md §5.

One sighting walks one way: :mod:`scenario` and :mod:`beacon_scenario` → what is true: :mod:`true_values`,
:mod:`flight`, :mod:`aim`, together in :mod:`scene` → what the devices say: :mod:`encoder`, :mod:`images`,
:mod:`baselines`, :mod:`drone_attitude`, together in :mod:`run` → :mod:`sources`. With d the deck, m the main frame, t
the telescope, b a drone, k the refraction coefficient:

    rotation_nm = rotation_nd · exp(deformation) · rotation_dm(encoder; axis errors)
    rotation_nt = rotation_nm · R(ΔA, ΔE, Δω)^T
    path_n      = drone + rotation_nb · light lever - rotation_nm · N'       drone: from the crossing of the axes
    baseline_n  = drone + rotation_nd · theodolite lever

A light is seen along its path raised by k · (horizontal distance) / (2 R), on the detector where the true focal length
puts it. Everything has the errors of its own that the scenario states, drawn once, or slow, or new each time.
"""
