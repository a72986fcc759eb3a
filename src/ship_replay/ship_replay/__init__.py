"""The suite offline: bags and black boxes replayed, runs evaluated, installations calibrated, configurations checked.

The package imports all others of the suite except those with displays, and runs their adapters. Its rooms, each above
the next: ``commands/`` command lines, ``campaign/`` many runs at once, ``report/`` their pages,
``calibration/``, ``evaluation/``, ``ins_noise/``, ``preflight/`` and ``trials/`` evaluations of a run, ``offline/``
the replay.
"""
