"""What a bag says of the installation of star sensors, and of the sightings that a theodolite's axes are fitted to.

One session walks one way: bag → :mod:`session` (the suite's own nodes) → :mod:`result` (installation angles with their
covariance, and which combinations of them the session could tell) → :mod:`tables`, :mod:`figure`, and the alignment
file that ``ship_attitude`` starts from. The room imports ``offline/`` alone.
"""
