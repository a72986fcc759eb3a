"""What is simulated: scenario files, read and checked, as frozen dataclasses.

The room draws nothing and imports no other room.
"""
