"""A simulated theodolite: drone lights in its calibration telescope, targets in its main tube, stars in cameras.

Data flow: scenario → paths of the drones and pointing of the main axis (:mod:`flight`) → true quantities (:mod:`scene`)
→ measurements of the devices (:mod:`devices`, :mod:`targets`, :mod:`mount_stars`) → all together in :mod:`run`. With d
the deck, m the main frame, t the telescope, b a drone, k the refraction coefficient:

    rotation_nm = rotation_nd · exp(deformation) · rotation_dm(encoder; axis errors)
    rotation_nt = rotation_nm · R(ΔA, ΔE, Δω)^T

    path_n      = drone + rotation_nb · light lever - rotation_nm · N'       drone: from the intersection of the axes
    baseline_n  = drone + rotation_nd · theodolite lever

A light is observed along its path raised by k · (horizontal distance) / (2 R), and imaged with the true focal length.
Each value has an error from the scenario: constant in a run, correlated, or white.

The folder imports ``stars/``, ``ship/``, ``draws/`` and ``scenario/``, and the pure geometry of ``theodolite_calib``.
"""
