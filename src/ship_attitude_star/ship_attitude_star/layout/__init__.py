"""The layout study: where on the ship to bolt star sensors, by the error model of their installation."""
