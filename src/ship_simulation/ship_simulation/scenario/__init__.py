"""What is simulated: scenario files, read and checked, as frozen dataclasses, and the names that follow from them.

The room draws nothing and imports no other room.
"""
