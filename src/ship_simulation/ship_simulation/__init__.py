"""Simulated voyages: motion, INS, star sensors, other attitude systems and theodolite of a ship, with errors and truth.

Data flow of a sample: scenario file → :mod:`scenario` → true motion and true sky (:mod:`ship`, :mod:`stars`) → devices
(:mod:`ship.attitude_device`, :mod:`stars.star_sightings`, :mod:`theodolite.devices`) → :class:`run.SimulatedRun`,
arrays only → :mod:`messages`, with :mod:`faults` → bag. The suite file of the scenario (:mod:`suite_file`) is attached
to the same bag. All devices draw their random numbers by :mod:`random_draws`.

The devices obey the equations of docs/explanation/filter.md, on which the estimators are built:

    R_true_nd(s + tau) = exp(a_n) exp(w_n) R_ins(s)
    R_star_ns(t + tau_s) = exp(c_n) R_true_nd(t + tau_s) exp(f_d) R0_ds exp(m_s) exp(n_s)

A sensor that gives single stars images a star in the direction v_n(t + tau_s), with refraction, at the pixel of
R_star_ns^T v_n. Noise of the pixel position then replaces n_s. The theodolite and the lights of drones are in
:mod:`ship_simulation.theodolite`.

The package imports geometry, parameter fields, bags, the star catalogue, star cameras, masks, parameters of INS errors,
and the pure geometry of a theodolite. It imports no estimator and no node.
"""
