"""Simulated voyages: a ship's motion, INS, star sensors, other attitude systems, theodolite, their errors, the truth.

One sample walks one way: scenario file → :mod:`scenario` → true motion and true sky (:mod:`ship`, :mod:`stars`) →
devices (:mod:`ship.attitude_device`, :mod:`stars.star_sightings`, :mod:`theodolite.devices`) →
:class:`run.SimulatedRun`, arrays alone → :mod:`messages`, spoilt by :mod:`faults` → bag. The suite file that fits the
scenario (:mod:`suite`) goes into the same bag.

The equations that the devices obey are those of docs/explanation/filter.md, which the estimators are built on:

    R_true_nd(s + tau) = exp(a_n) exp(w_n) R_ins(s)
    R_star_ns(t + tau_s) = exp(c_n) R_true_nd(t + tau_s) exp(f_d) R0_ds exp(m_s) exp(n_s)

A sensor that gives single stars sees the star whose direction is v_n(t + tau_s), refraction included, on the pixel of
R_star_ns^T v_n, with noise on the pixel in place of n_s. The theodolite and the lights of the drones that it looks at
are in :mod:`ship_simulation.theodolite`.

The package knows geometry, the style of parameters, bags, the star catalogue, a star camera, and the pure geometry of a
theodolite. It knows no estimator and no node.
"""
