"""Simulated voyages: a ship's motion, INS, star sensors, other attitude systems, theodolite, their errors, the truth.

One sample walks one way: scenario file → :mod:`scenario` → carrier (:mod:`motion`) and :mod:`sky` → devices
(:mod:`ins`, :mod:`attitude_device`, :mod:`star_sightings`, :mod:`inertial_device`) → :class:`run.SimulatedRun`
(numpy only) → :mod:`to_messages` → bag.
The equations that the devices obey are those of models.md §4, which the estimator is built on:

    R_true_nd(s + tau) = exp(a_n) exp(w_n) R_ins(s)
    R_star_ns(t + tau_s) = exp(c_n) R_true_nd(t + tau_s) exp(f_d) R0_ds exp(m_s) exp(n_s)

A sensor that gives single stars sees the star whose direction is v_n(t + tau_s), refraction included, on the pixel of
R_star_ns^T v_n, with noise on the pixel in place of n_s. The theodolite and the lights of the drones that it looks at
are in :mod:`ship_replay.simulation.theodolite`.
"""
