"""May an input be used? Whether it can be true by what the other inputs say, and what a lasting disagreement means.

The room watches the streams of all inputs by the guards of :mod:`ship_estimation`, and has the words for an operator
where a source and the INS keep disagreeing. It imports the measurements and the exposures of
``stars/``, and no filter.
"""
