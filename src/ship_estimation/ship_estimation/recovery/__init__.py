"""The way back after a fault: a second estimator runs beside the first one in trouble, and replaces it if it is right.

``trouble`` detects that an estimator does not do what its inputs allow, ``memory`` keeps its last undisputed state,
``displacement`` measures whether a source that contradicted the others has moved back, and ``recovery`` joins them: it
starts the second estimator and decides on its adoption. The rules are on the page explanation/when_inputs_fail.md.
"""
