"""Parameters: configurations as frozen dataclasses, their fields, and devices that nodes and scenarios share."""
