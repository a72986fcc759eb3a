"""What a run was worth: errors against the truth, innovations, estimates, as tables and figures, against bounds.

The room reads what nodes have published. Of this package it imports ``offline/`` alone.
"""
