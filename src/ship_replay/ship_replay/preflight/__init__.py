"""What is wrong with a suite configuration, by itself and against a bag: said before the voyage.

Of this package the room imports ``offline/`` alone.
"""
