"""The suite offline: bags and black boxes replayed, runs evaluated, installations calibrated, configurations checked.

The package stands above all others of the suite but those that people look at, and knows their adapters. Its rooms,
each above the next: ``commands/`` what people type, ``campaign/`` many runs at once, ``report/`` their pages,
``calibration/``, ``evaluation/``, ``ins_noise/``, ``preflight/`` and ``trials/`` what is asked of a run, ``offline/``
the replay.
"""
