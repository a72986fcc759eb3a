"""A simulated theodolite: drone lights in its calibration telescope, targets in its main tube, stars in cameras.

Data flow: scenario → paths of the drones, pointing of the main axis and other true quantities (:mod:`scene`) →
measurements of the devices (:mod:`devices`) → all together, with the stars in cameras, in :mod:`run`. The frames are
the horizon n, the deck d, the main frame m, the telescope t, and a drone b:

    rotation_nm = rotation_nd · exp(deformation) · rotation_dm(encoder; axis errors)
    rotation_nt = rotation_nm · R(ΔA, ΔE, Δω)^T

    path_n      = drone + rotation_nb · light lever - rotation_nm · N'       drone: from the intersection of the axes
    baseline_n  = drone + rotation_nd · theodolite lever

ΔA, ΔE, Δω are the angles of the main axis in the telescope, and N' is the vector from the intersection of the axes to
the principal point of the telescope's lens. A light is observed along ``path_n``, raised by k · (horizontal distance) /
(2 R) with the refraction coefficient k and the Earth radius R, and is imaged with the true focal length. Each value has
an error from the scenario, which is constant in a run, correlated, or white.

The folder imports ``stars/``, ``ship/``, ``random_draws`` and ``scenario/``.
"""
