"""Study before the voyage: accuracy of the pointing from beacons on drones, and its contributions.

The accuracies are those of ``escort``, from the calibration filter's own model. The folder imports ``escort``,
``filter``, ``config`` and below, and the modules that write files.
"""
