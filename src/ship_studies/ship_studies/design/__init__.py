"""Study before the voyage: accuracy of the pointing from beacons on drones, by source of error.

The folder ``escort`` computes the accuracies with the model of the calibration filter. This folder imports ``escort``,
the folders that :mod:`theodolite_calib` names below ``escort``, and modules that write files.
"""
