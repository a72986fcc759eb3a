"""Study before the voyage: accuracy of the pointing from beacons on drones, by source of error.

:mod:`theodolite_calib.escort` computes the accuracies with the model of the calibration filter. Of ``theodolite_calib``
this folder imports ``escort`` and the folders below it.
"""
