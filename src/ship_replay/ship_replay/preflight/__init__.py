"""What is wrong with a suite configuration, by itself and against a bag: said before the voyage.

The room imports ``offline/`` alone.
"""
