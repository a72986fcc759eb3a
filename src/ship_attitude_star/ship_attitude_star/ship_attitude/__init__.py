"""Core of the node ``ship_attitude``: ship attitude with error budget from INS and star measurements.

- ``core`` runs ``filter`` in a time-ordered estimator.
- ``devices`` defines the parameters of the sensors, and the device and states that follow from them. ``model`` defines
  the state vector.
- ``measurements`` linearises the measurements of all kinds of sensors, iteratively for an uncertain state.
- ``faults`` excludes faulty sources; ``ins`` checks the INS samples and corrects them by the filter.
- ``attitude_output`` and ``output`` compute the published attitude. ``alignment`` defines the alignment that is saved
  for the next voyage.
"""
