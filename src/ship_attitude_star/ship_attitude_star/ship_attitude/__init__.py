"""Core of the node ``ship_attitude``: ship attitude with error budget from INS and star measurements.

- ``core`` runs ``filter`` in a time-ordered estimator; ``state`` is its state, ``model`` the state vector.
- ``config`` defines the parameters of the sensors, and the device and states that follow from them.
- ``measurements`` linearises the measurements of all kinds of sensors, iteratively for an uncertain state.
- ``decision_effects`` records accepted and rejected measurements; ``faults`` excludes faulty sources.
- ``ins_input`` checks the INS samples, ``corrected_ins`` corrects them by the filter, and ``attitude_output`` selects
  the published attitude.
- ``alignment`` is saved for the next voyage; ``recovery`` compares and restarts estimators; ``observability``
  recommends turns.
"""
