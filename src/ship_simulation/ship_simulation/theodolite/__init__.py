"""A simulated theodolite: lights of drones in its calibration telescope, targets in its main tube, stars in cameras.

One sighting walks one way: scenario → where the drones fly and the main axis looks (:mod:`flight`) → all that is true
(:mod:`scene`) → what the devices say (:mod:`devices`, :mod:`targets`, :mod:`mount_stars`) → together in :mod:`run`.
With d the deck, m the main frame, t the telescope, b a drone, k the refraction coefficient:

    rotation_nm = rotation_nd · exp(deformation) · rotation_dm(encoder; axis errors)
    rotation_nt = rotation_nm · R(ΔA, ΔE, Δω)^T
    path_n      = drone + rotation_nb · light lever - rotation_nm · N'       drone: from the crossing of the axes
    baseline_n  = drone + rotation_nd · theodolite lever

A light is seen along its path raised by k · (horizontal distance) / (2 R), on the detector where the true focal length
puts it. Each value has an error that the scenario states: drawn once a run, or slow, or new in each sample.

The room imports ``stars/``, ``ship/``, ``draws/`` and ``scenario/``, and the pure geometry of ``theodolite_calib``.
"""
