"""Parameters: configurations as frozen dataclasses, and the schemas that several packages share."""
