"""The suite offline: bags and black boxes replayed, runs evaluated, installations calibrated, configurations checked.

The package imports the adapters of all nodes. Only ``ship_monitor``, ``ship_nmea`` and ``ship_bringup`` may import the
package. Each folder may import the folders after it in this list: ``commands/`` (command lines), ``campaign/`` (many
runs), ``report/`` (pages), ``calibration/``, ``evaluation/``, ``ins_noise/`` and ``preflight/`` (results of a run),
``offline/`` (replay). None of these folders imports ``trials/`` (many runs for tests and tools).
"""
